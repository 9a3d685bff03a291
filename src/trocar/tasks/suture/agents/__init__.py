"""Agents of the sutures."""
