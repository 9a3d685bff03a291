"""Errors whose cause is outside Trocar: bad input, and trouble with the machine."""


class TrocarError(ValueError):
    """Bad input: one sentence that names the item, its value, the bounds or choices, and the remedy.

    The command line prints the sentence and exits with code 2; a traceback is a bug of ours.
    """


class MachineError(TrocarError):
    """The machine's trouble, not the input's: a full disk, a folder that may not be written into, too little memory.

    The command line prints the sentence and exits with code 3.
    """
