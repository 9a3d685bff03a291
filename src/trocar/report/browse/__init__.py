"""All runs below some folders, as pages in the browser: a table, failures of each, two side by side, replays."""

from trocar.report.browse.server import BrowseServer
from trocar.report.browse.shelf import Run, Shelf

__all__ = ["BrowseServer", "Run", "Shelf"]
