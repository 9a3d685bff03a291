"""Commands of the suture task: ``plan suture``, ``plan setup``, ``study suture``."""
