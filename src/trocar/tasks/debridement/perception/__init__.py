"""Perception of the debridement: fragments, grippers and the receptacle, seen by two eyes."""
