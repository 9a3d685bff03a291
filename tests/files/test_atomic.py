"""Drafts of processes that were killed are removed by the next one that writes there; all else stays."""

import subprocess
import sys

import pytest

from trocar.files import output
from trocar.files.output import clear_drafts, drafted, write_json

WRITER = """
import sys, time
from pathlib import Path
from trocar.files.output import drafted
with drafted(Path(sys.argv[1])) as draft:
    draft.write_text("half a")
    print(draft, flush=True)
    time.sleep(600)
"""
OTHERS = (".trial_000.part.npz", ".trocar-notes", "trocar-1-1.part.npz", ".1234.part", ".trocar-1-1.part.npz.mine")


def test_the_draft_of_a_killed_process_is_removed_and_that_of_a_living_one_is_not(tmp_path):
    for name in OTHERS:
        (tmp_path / name).write_text("somebody else's")
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path / "trial.npz")], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        draft = process.stdout.readline().strip()
        write_json(tmp_path / "a.json", {}, "plan")
        assert draft in {str(path) for path in tmp_path.iterdir()}, "it is being written"
        process.kill()
    write_json(tmp_path / "b.json", {}, "plan")
    assert {path.name for path in tmp_path.iterdir()} == {*OTHERS, "a.json", "b.json"}


def test_two_drafts_of_one_process_do_not_meet(tmp_path):
    with drafted(tmp_path / "a.npz") as one, drafted(tmp_path / "a.npz") as other:
        assert one != other and one.is_file() and other.is_file()
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(output.fcntl is None, reason="without locks, nobody clears")
def test_a_draft_that_another_process_clears_before_it_is_locked_is_made_anew(tmp_path, monkeypatch):
    lock, locked = output.fcntl.flock, []

    def late(handle, how):
        if how == output.fcntl.LOCK_SH:
            locked.append(handle)
            if len(locked) == 1:
                clear_drafts(tmp_path)  # as another process would
        lock(handle, how)

    monkeypatch.setattr(output.fcntl, "flock", late)
    with drafted(tmp_path / "trial.npz") as draft:
        assert len(locked) == 2 and draft.is_file()
        clear_drafts(tmp_path)
        assert draft.is_file(), "it is locked"
    assert not list(tmp_path.iterdir())
