"""Sutures round a circle, driven along the needle primitive; everything of the task is in this folder."""
