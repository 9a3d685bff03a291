"""The one base class of every error that a user can cause."""


class TrocarError(ValueError):
    """Bad input: one sentence that names the item, its value, the bounds or choices, and the remedy.

    The command line prints the sentence and exits with code 2; a traceback is a bug of ours.
    """
