"""Multilateral debridement (Kehoe 2014): what is this task's own, all in this folder."""
