"""Multilateral debridement (Kehoe 2014); everything of the task is in this folder."""
