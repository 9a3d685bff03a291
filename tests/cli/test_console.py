"""``trocar console``: trial after trial, each with the method that a person chooses on the page."""

import pytest

import trocar.cli.console as trocar_console
from trocar import console
from trocar.console import Watch
from trocar.console.lobby import Lobby
from trocar.eval.folder import load_trials
from trocar.view.wishes import Said, Wish

SHORT = ("peg-transfer", "--transfers", "1", "--seed", "3")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--confirm", "everything"), "nothing, goals, motions"),
        (("--speed", "-1"), "above 0"),
        (("--enable-motion",), "no --robot is named"),
        (("--method", "policy"), "trocar run"),
        (("--method", "person", "--calibration", "joints"), "drop --calibration"),
        (("--robot", "crtk:peg-transfer", "--method", "uncalibrated"), "add --enable-motion"),
        (("--robot", "crtk:peg-transfer", "--method", "uncalibrated", "--speed", "2"), "simulated cell"),
    ],
)
def test_what_cannot_be_is_refused_before_a_page_opens(trocar, tmp_path, words, said):
    code, out, err = trocar("console", *SHORT, *words, "--out", tmp_path / "day")
    assert code == 2 and said in " ".join((out + err).split())
    assert not (tmp_path / "day").exists()


class Day(Watch):
    """A console without a page, whose person does nothing in each trial, and begins these."""

    plan, seen = [], []

    def __init__(self, level, speed, inputs, told):
        super().__init__(level, 0.0, port=None)

    def _hear(self):
        if not isinstance(self.console, Lobby) or self.console.chosen:
            return [Said(Wish.DONE)]
        Day.seen.append(self.console.standing.words)
        if not self.plan:
            raise KeyboardInterrupt
        return [Said(Wish.BEGIN, value=self.plan.pop(0))]


def test_trials_come_one_after_the_other_and_are_reported_at_the_end(trocar, tmp_path, monkeypatch):
    monkeypatch.setattr(console, "Watch", Day)
    Day.plan[:], Day.seen[:] = ("none such", "person", "person-calibrated"), ()
    how = ("--method", "person-calibrated", "--calibration", "joints", "--out", tmp_path / "day", "--no-open")
    code, _, err = trocar("console", *SHORT, *how)
    assert code == 0, err
    trials, strange = load_trials(tmp_path / "day" / "person-calibrated")
    assert len(trials) == 2 and not strange and [trial.about["index"] for trial in trials] == [0, 1]
    assert (tmp_path / "day" / "person-calibrated" / "report.html").is_file()
    first, other, second = dict.fromkeys(word.partition(". Choose")[0] for word in Day.seen)
    assert first == "Trial 1 with person-calibrated: 0 of 1 transfers"
    assert other.startswith("No trial with person: --calibration joints")
    assert second == "Trial 2 with person-calibrated: 0 of 1 transfers"
    report = tmp_path / "day" / "person-calibrated" / "report.html"
    written = report.stat().st_mtime_ns
    code, out, err = trocar("console", *SHORT[:-1], "4", *how)
    assert code == 2 and "choose another" in " ".join((out + err).split())
    assert report.stat().st_mtime_ns == written, "a run that is another one is left alone"


def test_somebody_at_a_terminal_is_asked_before_real_arms_move(trocar, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(trocar_console, "agreed", lambda *_, **__: True)
    monkeypatch.setattr(trocar_console.typer, "confirm", lambda words, **_: asked.append(words))
    monkeypatch.setattr(trocar_console, "_one_more", lambda *_: pytest.fail("arms move"))
    how = ("--robot", "crtk:peg-transfer", "--method", "uncalibrated", "--enable-motion", "--out", tmp_path / "day")
    code, _, _ = trocar("console", *SHORT[:-2], *how)
    assert code == 1 and len(asked) == 1 and "may the arms move?" in asked[0]
