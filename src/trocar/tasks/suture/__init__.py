"""Sutures round a circle, driven along the needle primitive: all of the task in this folder."""
