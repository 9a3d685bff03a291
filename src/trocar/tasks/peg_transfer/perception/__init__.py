"""Perception of the peg transfer."""
