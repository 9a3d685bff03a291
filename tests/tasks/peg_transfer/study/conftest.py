import pytest

from trocar.tasks.peg_transfer.study import row

KEPT = {}


@pytest.fixture(autouse=True)
def _analysed_once(monkeypatch):
    """Analyse each made-up path once in all tests of the study: they are the same few, and each takes a second."""
    analyse = row.analyse_joints

    def analysed(arm, measured, step_s, *rest):
        key = arm.name, measured.tobytes(), step_s, rest
        if key not in KEPT:
            KEPT[key] = analyse(arm, measured, step_s, *rest)
        return KEPT[key]

    monkeypatch.setattr(row, "analyse_joints", analysed)
