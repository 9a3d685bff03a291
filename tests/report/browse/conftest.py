"""Made-up runs, and the server that shows them."""

import pytest

from browsed import made_runs
from trocar.report.browse import BrowseServer, Shelf


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return made_runs(tmp_path_factory.mktemp("lab"))


@pytest.fixture(scope="module")
def served(folder):
    with BrowseServer(Shelf([folder]), 0) as pages:
        yield pages
