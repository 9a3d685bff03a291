"""The pages as they are served: what each says, what is refused, and replays on demand."""

import re
import urllib.error
import urllib.request
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import quote

import pytest

from browsed import made_runs
from synthetic import config, keep, synthetic_trial
from trocar.eval.folder import load_trials
from trocar.eval.trial import trial_file
from trocar.report.browse import BrowseServer, Shelf
from trocar.report.failures import LEAD_S
from trocar.report.files import report_of


class Read(HTMLParser):
    """A page's words, links and the rows of its tables."""

    def __init__(self, html):
        super().__init__()
        self.words, self.links, self.rows = [], {}, []
        self._link = None
        self.feed(re.sub(r"<style>.*?</style>", "", html, flags=re.DOTALL))
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag == "a":
            self._link = given["href"]
        if tag == "iframe":
            self.links["iframe"] = given["src"]
        if tag == "tr":
            self.rows.append("")

    def handle_endtag(self, tag):
        if tag == "a":
            self._link = None

    def handle_data(self, data):
        self.words.append(data)
        if self.rows:
            self.rows[-1] += f"{data} "
        if self._link is not None:
            self.links[data] = self._link


@pytest.fixture
def get(served):
    def page(address, **headers):
        request = urllib.request.Request(served.address.rstrip("/") + address, headers=headers)
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request) as answer:
            return Read(answer.read().decode())

    return page


def refused(get, address, **headers):
    with pytest.raises(urllib.error.HTTPError) as error:
        get(address, **headers)
    return error.value.code, Read(error.value.read().decode()).text


def names(page):
    """Return the runs of a table, from top to bottom."""
    return [name for name, where in page.links.items() if where.startswith("/runs/")]


def test_the_table_has_every_run_and_what_is_wrong_with_it(get):
    page = get("/")
    assert names(page) == ["begun", "day/bad", "day/good", "lost", "other", "torn", "unfinished"]
    (bad,) = (row for row in page.rows if row.startswith("day/bad"))
    low_high = re.search(r"66\.7 % *\((\d+) to (\d+)\) *24 of 36", bad)
    assert low_high and int(low_high[1]) < 67 < int(low_high[2])
    assert all(word in bad for word in ("peg-transfer", "unilateral", "uncalibrated", "mild", "3 × 1", "5.00"))
    for said in ("no trial is finished yet", "run.json cannot be read", "'session_00/trial_000.npz' is not a readable"):
        assert said in page.text


def test_a_click_on_a_heading_sorts_and_another_turns_it_round(get):
    up = get(get("/").links["success (95 %)"])
    known = ["day/bad", "day/good", "other"]
    assert [name for name in names(up) if name in known] == known
    down = get(up.links["success (95 %)"])
    assert [name for name in names(down) if name in known] == ["other", "day/good", "day/bad"]
    assert set(names(down)[-2:]) == {"begun", "lost"}, "what is unknown comes last either way"
    assert names(get("/?by=nonsense")) == names(get("/"))


def test_a_run_s_page_begins_with_its_failures_and_leads_to_each(get):
    page = get(get("/").links["day/bad"])
    assert "Failures: 12 of 36 transfers" in page.text
    assert "made up: NOT_GRASPED" in page.text
    failures = [where for name, where in page.links.items() if name.startswith("transfer ")]
    assert sum(row.startswith("transfer ") for row in page.rows) == 12
    assert failures and all("/session_0" in where and "?goal=" in where for where in failures)
    trials = [name for name in page.links if name.startswith("session ")]
    assert trials == [f"session {k}, trial 0" for k in range(3)]
    assert page.text.index("Failures") < page.text.index("Trials")
    good = get(get("/").links["day/good"])
    assert next(name for name in good.links if name.startswith("session ")) == "session 1, trial 0", "failures first"
    assert "every transfer that was attempted succeeded" in get(get("/").links["other"]).text


def test_a_run_without_trials_has_a_page_too(get):
    assert "no trial is finished yet" in get(get("/").links["begun"]).text
    assert "run.json cannot be read" in get(get("/").links["lost"]).text


def test_a_trial_s_page_begins_its_replay_before_the_failure_that_was_clicked(get, folder):
    page = get(get("/").links["day/good"])
    (failure,) = (where for name, where in page.links.items() if name.startswith("transfer 5"))
    trial = load_trials(folder / "day" / "good")[0][1]
    moment_s = report_of(trial).failed_s(trial, trial.scores[4])
    assert 20.0 < moment_s < 25.0, "when the block fell, not when the transfer ended"
    shown = get(failure)
    assert shown.links["iframe"] == f"replay.html#t={moment_s - LEAD_S:.2f}"
    assert get(page.links["session 1, trial 0"]).links["iframe"] == shown.links["iframe"], "the first failure"
    assert get(page.links["session 0, trial 0"]).links["iframe"] == "replay.html#t=0.00", "nothing failed"
    assert "transfer 5" in shown.rows[1] and "dropped" in shown.rows[1]
    assert "made up: DROPPED" in shown.rows[2]
    assert "trocar view" in shown.text
    assert set(shown.links) >= {"All runs", "day/good", "Trial before", "Next trial"}


def test_a_trial_whose_script_was_stopped_says_so_and_is_shown_at_its_end(tmp_path):
    made_runs(tmp_path)
    path = trial_file(tmp_path / "day" / "good", 2, 0)
    run = load_trials(tmp_path / "day" / "good")[0][2]
    replace(run, ended="AGENT_ERROR", reason="division by zero").save(path)
    pages = BrowseServer(Shelf([tmp_path]), 0)
    with pages:
        page = Read(pages.page("/runs/day%2Fgood/"))
        assert "agent error division by zero" in " ".join(page.rows[1].split())
        shown = Read(pages.page(page.links["the whole trial"]))
    assert shown.links["iframe"] == f"replay.html#t={run.duration_s - LEAD_S:.2f}"
    assert "Stopped: division by zero" in shown.text


def test_two_runs_stand_side_by_side_with_the_difference_over_their_sessions(get):
    page = get("/compare?run=day%2Fgood&run=day%2Fbad")
    assert "The difference over the 3 sessions that both have" in page.text
    (success,) = (row for row in page.rows if row.startswith("success"))
    assert "97.2 %" in success and "66.7 %" in success and "+30.6 points" in success and "p 0.125" in success
    assert any(row.split() == ["method", "calibrated", "uncalibrated"] for row in page.rows)
    sessions = [row.split() for row in page.rows if re.match(r"session \d", row)]
    assert [row[1] for row in sessions] == ["2", "0", "1"], "where they differ most comes first"
    assert sessions[0][2:] == ["12", "of", "12", "7", "of", "12", "+41.7"]
    assert "-30.6 points" in get(page.links["Swap"]).text
    others = get(get("/").links["day/good"])
    assert others.links["day/bad"] == "/compare?run=day%2Fgood&run=day%2Fbad"


@pytest.mark.parametrize(
    ("two", "words"),
    [("other", "did not meet the same sessions"), ("begun", "without finished trials"), ("day/good", "+0.0 points")],
)
def test_runs_that_cannot_be_compared_are_shown_and_told(get, two, words):
    assert words in get(f"/compare?run=day%2Fgood&run={quote(two)}").text


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("/compare?run=other", "A comparison of 1 run cannot be shown; tick two in the table"),
        ("/compare?run=other&run=nowhere", "Run 'nowhere' is not here"),
        ("/runs/nowhere/", "Run 'nowhere' is not here"),
        ("/runs/..%2Fsecret/report.html", "is not here"),
        ("/runs/other/report.html", "does not exist"),
        ("/runs/other/run.json", "does not exist"),
        ("/runs/other/session_00/trial_007/", "has no trial 7 of session 0"),
        ("/runs/other/session_00/..%2F..%2Frun/", "has no trial -1 of session 0"),
        ("/etc/passwd", "does not exist"),
    ],
)
def test_what_is_not_there_is_a_sentence_on_a_page(get, address, words):
    code, text = refused(get, address)
    assert code == 404 and words in text and "All runs" in text


def test_a_mistake_in_a_page_is_a_sentence_on_a_page_and_its_traceback_is_in_the_terminal(get, monkeypatch, capsys):
    monkeypatch.setattr("trocar.report.browse.server.one_run_page", lambda run, others: {}["<peg 13>"])
    code, text = refused(get, "/runs/other/")
    assert code == 500 and "A mistake in Trocar or in a plugin (KeyError: '<peg 13>')" in text and "All runs" in text
    assert "Traceback" in capsys.readouterr().err


def test_only_this_machine_is_answered_under_its_own_name(get, served):
    assert served.address.startswith("http://127.0.0.1:")
    assert served._server.server_address[0] == "127.0.0.1"
    assert refused(get, "/", Host="evil.example:80")[0] == 403
    assert get("/", Host="localhost:80").rows
    assert get("/", Host="localhost").rows, "browsers leave out port 80"


def test_a_run_s_own_report_and_replay_are_served_beside_its_page(get, folder):
    for name in ("report.html", "replay.html"):
        (folder / "other" / name).write_text(f"<p>{name} of the run")
    page = get("/runs/other/")
    try:
        assert page.links["Its report"] == "report.html"
        assert [get(f"/runs/other/{name}").text for name in ("report.html", "replay.html")] == [
            "report.html of the run",
            "replay.html of the run",
        ]
    finally:
        for name in ("report.html", "replay.html"):
            (folder / "other" / name).unlink()


def test_new_trials_are_there_when_a_page_is_loaded_again(tmp_path):
    made_runs(tmp_path)
    with BrowseServer(Shelf([tmp_path]), 0) as pages:
        assert "1 of the run's 2 trials exist" in Read(pages.page("/runs/unfinished/")).text
        keep(synthetic_trial(config(sessions=2, seed=9), session=1), tmp_path / "unfinished")
        assert "1 of the run's 2 trials exist" not in Read(pages.page("/runs/unfinished/")).text


def test_a_replay_is_made_when_it_is_asked_for_once_and_not_in_the_run(folder, monkeypatch):
    pytest.importorskip("viser")
    made = []
    monkeypatch.setattr(
        "trocar.view.replay.write_replay", lambda replay, path: made.append(replay) or path.write_text("3D")
    )
    before = sorted(folder.rglob("*"))
    address = "/runs/day%2Fgood/session_01/trial_000/"
    with BrowseServer(Shelf([folder]), 0) as pages:
        pages.page(address)
        assert made == []
        path = Path(pages.page(f"{address}replay.html"))
        assert path.read_text() == "3D" and pages.page(f"{address}replay.html") == path
        assert len(made) == 1
        colours = {solid.body: solid.rgba for solid in made[0].solids}
        assert colours["block0"] != (0.8, 0.2, 0.1, 1.0), "the task's colours for people"
    assert sorted(folder.rglob("*")) == before
    assert not path.exists(), "nothing is left behind"


def test_without_viser_the_pages_work_and_the_extra_is_named(get, monkeypatch):
    monkeypatch.setattr("trocar.report.browse.one_trial.find_spec", lambda module: None)
    page = get("/runs/day%2Fgood/session_01/trial_000/")
    assert "The replay needs viser; install the extra" in page.text and "iframe" not in page.links


def test_a_taken_port_gives_the_next_one(folder):
    with BrowseServer(Shelf([folder]), 0) as first:
        port = int(first.address.rstrip("/").rpartition(":")[2])
        with BrowseServer(Shelf([folder]), port) as second:
            assert second.address != first.address
