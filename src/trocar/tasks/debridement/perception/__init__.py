"""Perception for debridement: fragments, grippers and the receptacle, seen by two eyes."""
