import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
SAYS = {
    "first_trial.py": "peg  1 to  7: ",
    "own_planner.py": "stop-and-go: ",
    "plan_sutures.py": "with gaps of 75 to 105 deg: ",
}


def test_every_example_is_tested():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(SAYS)


@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs(name, tmp_path):
    result = subprocess.run(
        [sys.executable, EXAMPLES / name],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert SAYS[name] in result.stdout
    if name == "first_trial.py":
        assert (tmp_path / "out" / "example" / "storyboard.png").stat().st_size > 10_000
