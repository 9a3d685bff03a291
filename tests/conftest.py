import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

# A shell that starts the tests in the background has them ignore Ctrl-C, and all that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A shared machine pauses where it likes: how long an example takes says nothing. Everybody's run tries the same
# examples, so that a failure is always news of the code; `--hypothesis-profile explore` tries new ones.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None, derandomize=False)
settings.load_profile("same")


def recordings_folder() -> Path:
    """Where the recordings lie: TROCAR_DATA, or shared/data beside the repository."""
    return Path(os.environ.get("TROCAR_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def recordings() -> Path:
    folder = recordings_folder()
    if not folder.is_dir():
        pytest.skip(f"the recordings are not at {folder}; set TROCAR_DATA to their folder")
    return folder
