import gc
import os
import signal
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

# Each worker of the tests has a core: threads of a linear algebra library beside it wait for one another, and took most
# of the time. Read by NumPy when it is loaded, so before anything else; processes that tests start inherit it.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_threads, "1")

# Processes that tests start compile nothing that another one has compiled: where no bytecode is kept, each of a hundred
# spends seconds on NumPy, SciPy and Matplotlib. It lies apart, so that no folder changes that a test looks at.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
if sys.pycache_prefix is None:
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix

# Calibrations of tests are shared by tests, and no test finds those of the user.
os.environ["TROCAR_CACHE"] = os.environ.get("TROCAR_TEST_CACHE") or tempfile.mkdtemp(prefix="trocar-calibrations-")
os.environ["TROCAR_TEST_CACHE"] = os.environ["TROCAR_CACHE"]  # workers of the tests inherit it

# A shell that starts the tests in the background has them ignore Ctrl-C, and all that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A shared machine pauses where it likes: how long an example takes says nothing. Everybody's run tries the same
# examples, so that a failure is always news of the code; `--hypothesis-profile explore` tries new ones.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None, derandomize=False)
settings.load_profile("same")


LONGEST = (
    "view/test_console_view",
    *("tasks/suture/commands/test_run_suture", "tasks/peg_transfer/agents/test_learner"),
    *("tasks/peg_transfer/report/test_peg_study", "tasks/peg_transfer/agents/test_faults", "cli/test_run"),
    *("eval/test_run", "test_examples", "tasks/test_truth_barrier", "eval/test_folder", "test_tutorial"),
    *("tasks/suture/test_trial", "sim/test_laboratory", "collect/test_collection", "report/test_files"),
    *("tasks/debridement/agents/test_faults", "tasks/suture/agents/test_circle", "eval/test_workers"),
    *("tasks/peg_transfer/agents/test_handover", "view/test_replay", "cli/test_collect"),
    *("tasks/test_every_task", "cli/test_bad_input", "calibration/test_lstm_training", "motion/test_sqp"),
    "view/test_replay_in_browser",
)
"""Files that take longest: first, for at the end one of them would keep one core busy, and the others idle; the two
that draw in a browser far apart, for each draws with all cores."""


def pytest_collection_modifyitems(items):
    """Put the tests of the longest files first; the others stay in their order."""
    places = {f"tests/{name}.py": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.nodeid.partition("::")[0], len(places)))


def pytest_collection_finish():
    """Let nobody look again and again through what was collected and stays: a third of a second each time."""
    gc.collect()
    gc.freeze()


def recordings_folder() -> Path:
    """Where the recordings lie: TROCAR_DATA, or shared/data beside the repository."""
    return Path(os.environ.get("TROCAR_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def recordings() -> Path:
    folder = recordings_folder()
    if not folder.is_dir():
        pytest.skip(f"the recordings are not at {folder}; set TROCAR_DATA to their folder")
    return folder


@pytest.fixture
def registries(monkeypatch):
    """Let a test register what it likes, by plugins too: afterwards everything is as it was."""
    from trocar.calibration.models import MODELS
    from trocar.eval import METHODS, PERCEPTIONS, TASKS
    from trocar.motion import PLANNERS

    for registry in (METHODS, PERCEPTIONS, TASKS, PLANNERS, MODELS):
        monkeypatch.setattr(registry, "_known", dict(registry._known))
    monkeypatch.setattr("trocar.registry._LOADED", {})


pytest_plugins = ["commands"]
