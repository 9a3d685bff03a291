"""``--config FILE``: the same as the words that it stands for."""

import pytest


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "run.toml"
        path.write_text(text)
        return path

    return write


class Seen(Exception):
    pass


@pytest.fixture
def seen(monkeypatch):
    """What a run was about to do when it was stopped."""
    found = {}

    def stop(config, folder):
        found.update(config=config, folder=folder)
        raise Seen

    monkeypatch.setattr("trocar.eval.folder.open_folder", stop)
    return found


def test_a_file_stands_for_the_words_of_a_run_and_words_override_it(trocar, tmp_path, seen, written):
    path = written(
        'task = "peg-transfer"\nmethod = "best"\ncalibration = "joints"\nsessions = 3\ntransfers = 2\n'
        'new_session = true\nrefit-offsets = false\nflaw = ["registration=1mm", "jaw=1deg"]\n'
    )
    code, _, err = trocar("run", "--config", path, "--sessions", 4, "--out", tmp_path / "out")
    assert code == 70 and "Seen" in err
    config = seen["config"]
    assert (config.task.name, config.task.transfers, config.method, config.calibration) == (
        "peg-transfer",
        2,
        "best",
        "joints",
    )
    assert (config.sessions, config.new_session, config.refit_offsets) == (4, True, False)
    assert config.how_difficult == ["recorded", "registration=1mm", "jaw=1deg"]


@pytest.mark.parametrize("task", ['task = "suture"\n', ""])
@pytest.mark.parametrize(
    "line", ["--config FILE peg-transfer", "peg-transfer --config=FILE", "peg-transfer --config FILE"]
)
def test_a_task_on_the_line_counts_and_not_that_of_the_file(trocar, tmp_path, seen, written, task, line):
    path = written(f'{task}method = "uncalibrated"\nsessions = 3\n')
    words = [word.replace("FILE", str(path)) for word in line.split()]
    code, _, err = trocar("run", *words, "--out", tmp_path / "out")
    assert code == 70 and "Seen" in err
    config = seen["config"]
    assert (config.task.name, config.method, config.sessions) == ("peg-transfer", "uncalibrated", 3)


LINES = ("demonstrations --config FILE", "--config FILE demonstrations", "demonstrations peg-transfer --config FILE")


@pytest.mark.parametrize("line", LINES)
def test_demonstrations_of_a_file_are_those_of_its_words(trocar, tmp_path, monkeypatch, written, line):
    found = []

    def stop(folder, conditions, *rest):
        found.extend(conditions)
        raise Seen

    monkeypatch.setattr("trocar.cli.learn.worked", stop)
    path = written('task = "peg-transfer"\nmethod = "best"\nepisodes = 3\n')
    code, _, err = trocar("study", *line.replace("FILE", str(path)).split(), "--seed", 4, "--out", tmp_path / "out")
    assert code == 70 and "Seen" in err
    config = found[0].config
    assert (config.task.name, config.method, config.sessions, config.seed) == ("peg-transfer", "best", 3, 4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sessions = 3", "names no task; give one"),
        ("task =", "is no readable TOML"),
        ('task = "peg-transfr"', "task 'peg-transfr' is unknown; did you mean 'peg-transfer'?"),
        ('task = "suture"\n[flaws]\nouter = 1', "has a table 'flaws'"),
        ('task = "suture"\nseed = -1', "the seed is -1"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(trocar, written, text, said):
    code, out, err = trocar("run", "--config", written(text))
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1


def test_one_file_must_be_named(trocar, written):
    assert "--config names no file" in trocar("run", "--config")[2]
    first = written('task = "peg-transfer"')
    assert "--config names a second file, after" in trocar("run", "--config", first, f"--config={first}")[2]
