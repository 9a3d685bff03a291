"""The simulator's side of the sutures: phantom, needle, referee. No agent may import this."""
