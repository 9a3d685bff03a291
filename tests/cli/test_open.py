"""``trocar open``: which pages it serves, what it prints, and what it refuses."""

import json
import urllib.request

import pytest

from browsed import made_runs
from trocar.cli import open as cli
from trocar.report.browse import BrowseServer


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return made_runs(tmp_path_factory.mktemp("lab"))


@pytest.fixture
def served(monkeypatch):
    """The pages that a run of the command serves and opens; it ends where it would wait."""
    seen = {"opened": [], "pages": []}

    def wait(server):
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(server.address) as answer:
            seen["pages"].append((server.address, answer.read().decode()))
        raise KeyboardInterrupt

    monkeypatch.setattr(cli.webbrowser, "open", seen["opened"].append)
    monkeypatch.setattr(BrowseServer, "wait", wait)
    return seen


def test_the_table_is_served_and_opened_until_ctrl_c(trocar, folder, served):
    code, out, err = trocar("open", folder / "day", folder / "other", "--port", 0)
    assert (code, out) == (0, "")
    ((address, page),) = served["pages"]
    assert "day/good" in page and "day/bad" in page and "other" in page and "unfinished" not in page
    assert served["opened"] == [address]
    assert f"3 runs: {address} in a browser; Ctrl-C ends\n" in err
    with pytest.raises(OSError):
        urllib.request.urlopen(address, timeout=2)


def test_no_browser_is_opened_if_not_wanted(trocar, folder, served):
    assert trocar("open", folder, "--no-open", "--port", 0)[0] == 0
    assert served["pages"] and served["opened"] == []


def test_json_is_the_table_and_nothing_is_served(trocar, folder, served):
    code, out, _ = trocar("open", folder, "--json")
    runs = {run["name"]: run for run in json.loads(out)["runs"]}
    assert code == 0 and served["pages"] == []
    assert set(runs) == {"begun", "day/bad", "day/good", "lost", "other", "torn", "unfinished"}
    good = runs["day/good"]
    assert (good["succeeded"], good["attempted"], good["sessions"], good["trials"]) == (35, 36, 3, 3)
    assert good["success_ci95"][0] < 35 / 36 < good["success_ci95"][1]
    assert runs["lost"]["remarks"] and runs["lost"]["success_rate"] is None


def test_a_folder_without_runs_is_one_sentence_and_an_empty_table(trocar, tmp_path, served):
    code, _, err = trocar("open", tmp_path)
    assert code == 2 and "is no run in or below" in " ".join(err.split()) and "trocar run" in err
    assert json.loads(trocar("open", tmp_path, "--json")[1]) == {"runs": []}
    assert served["pages"] == []
