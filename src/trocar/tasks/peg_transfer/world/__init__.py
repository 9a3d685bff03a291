"""The simulator's side of the peg transfer: bodies and referee. No agent may import this."""
