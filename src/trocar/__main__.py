"""``python -m trocar`` is the command ``trocar``."""

from trocar.cli import main

main()
