"""The simulator's side of debridement: bodies and referee."""
