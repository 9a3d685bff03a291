import gc
import os
import signal
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

# Each test worker uses one core: more threads of linear algebra only wait for one another, which took most of the time.
# NumPy reads these variables when it is imported, so they are set first. Processes that tests start inherit them.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_threads, "1")

# Keep bytecode: without it, each of a hundred processes that tests start spends seconds on compiling NumPy, SciPy and
# Matplotlib. It is in a folder of its own, so that it does not change folders that tests compare.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
if sys.pycache_prefix is None:
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix

# Tests share a cache of calibrations, apart from the user's.
os.environ["TROCAR_CACHE"] = os.environ.get("TROCAR_TEST_CACHE") or tempfile.mkdtemp(prefix="trocar-calibrations-")
os.environ["TROCAR_TEST_CACHE"] = os.environ["TROCAR_CACHE"]  # workers of the tests inherit it

# A shell that starts the tests in the background makes them, and the processes that they start, ignore Ctrl-C: undo it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No deadline, because a shared machine may pause at any time. Every run tries the same examples, so that a new failure
# always comes from the code; `--hypothesis-profile explore` tries new ones.
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
"""The slowest test files, run first: at the end, one of them would keep one core busy while the others are idle. The
two that draw in a browser are far apart, because each uses all cores."""


def pytest_ignore_collect(collection_path, config):
    """Leave out files without a test of the one kind that is asked for: to import them all takes half a minute."""
    kind = config.option.markexpr
    if kind in ("slow", "realtime") and collection_path.name.startswith("test_"):
        return f"mark.{kind}" not in collection_path.read_text(encoding="utf-8") or None
    return None


def pytest_collection_modifyitems(items):
    """Put the tests of the longest files first; the others stay in their order."""
    places = {f"tests/{name}.py": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.nodeid.partition("::")[0], len(places)))


def pytest_collection_finish():
    """Exempt the collected tests, which stay anyway, from garbage collections: each would take a third of a second."""
    gc.collect()
    gc.freeze()


def recordings_folder() -> Path:
    """Return the folder of the recordings: TROCAR_DATA, or shared/data beside the repository."""
    return Path(os.environ.get("TROCAR_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def recordings() -> Path:
    folder = recordings_folder()
    if not folder.is_dir():
        pytest.skip(f"the recordings are not at {folder}; set TROCAR_DATA to their folder")
    return folder


@pytest.fixture
def registries(monkeypatch):
    """Restore all registries after a test, whatever it or its plugins have registered."""
    from trocar.calibration.models import MODELS
    from trocar.eval import METHODS, PERCEPTIONS, TASKS
    from trocar.motion import PLANNERS

    for registry in (METHODS, PERCEPTIONS, TASKS, PLANNERS, MODELS):
        monkeypatch.setattr(registry, "_known", dict(registry._known))
    monkeypatch.setattr("trocar.registry._LOADED", {})


pytest_plugins = ["commands"]
