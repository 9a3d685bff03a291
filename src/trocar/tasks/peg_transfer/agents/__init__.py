"""Agents of the peg transfer."""
