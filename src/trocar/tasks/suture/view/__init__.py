"""A suture plan in the browser."""
