"""``trocar`` without pictures and replay, which take longer than a short trial, for tests of other things."""

COMMAND = """
from trocar.cli import main
from trocar.report import files
files._pictures = lambda *rest: ([], None)
files.can_photograph = lambda: False
files.find_spec = lambda module: None
main()
"""
