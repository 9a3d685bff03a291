"""Data sets that are written: layouts, videos, statistics, what is kept and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose

from made_episodes import COLOURS, short
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.learn import dataset
from trocar.learn.dataset import export_lerobot
from trocar.learn.episode import ACTION, STATE, episode_of

CAMERA = "observation.images.overhead"


def loaded(path):
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def trials():
    return [short(0), short(1, success=False), short(2)]


@pytest.fixture(scope="module", params=["lerobot", "open-h"])
def folder(request, trials, tmp_path_factory):
    place = tmp_path_factory.mktemp(request.param)
    done = export_lerobot(trials, place, layout=request.param)
    assert (done.episodes, done.frames, done.left_out) == (3, 273, 0)
    return place


def interrupted(trials):
    """Trials of which the last one is never there, because somebody presses Ctrl-C."""

    class Interrupted(list):
        def __iter__(self):
            yield from self[:-1]
            raise KeyboardInterrupt

    return Interrupted(trials)


def frames(folder):
    return [pq.read_table(path) for path in sorted((folder / "data").rglob("*.parquet"))]


def test_every_frame_is_that_of_its_trial(folder, trials):
    for number, (table, trial) in enumerate(zip(frames(folder), trials, strict=True)):
        episode = episode_of(trial)
        for key in (STATE, ACTION):
            assert np.array_equal(np.array(table[key].to_pylist(), np.float32), episode.columns[key])
        assert table["episode_index"].to_pylist() == [number] * 91
        assert table["index"].to_pylist() == list(range(91 * number, 91 * number + 91))
        assert table["frame_index"].to_pylist() == list(range(91))
        assert_allclose(table["timestamp"].to_pylist(), np.arange(91) / 30, rtol=1e-6)


def test_info_describes_every_column(folder):
    info, table = loaded(folder / "meta" / "info.json"), frames(folder)[0]
    assert (info["fps"], info["robot_type"], info["total_frames"], info["splits"]) == (
        30,
        "dvrk",
        273,
        {"train": "0:3"},
    )
    assert set(table.column_names) == {key for key, one in info["features"].items() if one["dtype"] != "video"}
    assert info["features"][CAMERA]["shape"] == [48, 64, 3]
    assert info["features"]["phase_index"]["info"]["phases"][0] == "capture"
    for key, one in info["features"].items():
        if one["names"] and one["dtype"] != "video":
            assert len(one["names"]) == one["shape"][0], key


def test_statistics_are_those_of_all_frames(folder):
    stats, tables = loaded(folder / "meta" / "stats.json"), frames(folder)
    values = np.vstack([np.array(table[STATE].to_pylist()) for table in tables])
    for name, found in (
        ("min", values.min(0)),
        ("max", values.max(0)),
        ("mean", values.mean(0)),
        ("std", values.std(0)),
    ):
        assert_allclose(stats[STATE][name], found, atol=1e-6)
    assert stats[STATE]["count"] == [273]
    shown = np.array([(0, 0, 0)] * 15 + [COLOURS[0]] * 30 + [COLOURS[1]] * 46) / 255
    assert_allclose(np.ravel(stats[CAMERA]["mean"]), shown.mean(0), atol=0.01)
    assert np.shape(stats[CAMERA]["std"]) == (3, 1, 1)


def test_videos_show_each_image_until_the_next_one(folder):
    import av

    for path in sorted((folder / "videos").rglob("*.mp4")):
        with av.open(str(path)) as file:
            seen = [frame.to_ndarray(format="rgb24").mean(axis=(0, 1)) for frame in file.decode(video=0)]
            assert file.streams.video[0].average_rate == 30
        assert len(seen) == 91
        for frame, colour in ((0, (0, 0, 0)), (14, (0, 0, 0)), (15, COLOURS[0]), (44, COLOURS[0]), (45, COLOURS[1])):
            assert_allclose(seen[frame], colour, atol=6)


def test_v30_lists_episodes_with_their_success(trials, tmp_path):
    export_lerobot(trials, tmp_path)
    listed = pq.read_table(tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert listed["success"].to_pylist() == [True, False, True]
    assert listed["failures"].to_pylist() == [[], ["DROPPED"], []]
    assert listed["dataset_from_index"].to_pylist() == [0, 91, 182]
    assert listed["dataset_to_index"].to_pylist() == [91, 182, 273]
    assert json.loads(listed["spans"][0].as_py())[0][:2] == ["psm1", "capture"]
    assert_allclose(listed[f"videos/{CAMERA}/to_timestamp"].to_pylist(), 91 / 30)
    tasks = pq.read_table(tmp_path / "meta" / "tasks.parquet")
    assert tasks["task"].to_pylist() == ["peg transfer unilateral"]
    steps = pq.read_table(tmp_path / "meta" / "subtasks.parquet")["subtask"].to_pylist()
    said = [steps[k] for k in frames(tmp_path)[0]["subtask_index"].to_pylist()]
    assert said[0] == "between goals" and said[30].startswith("psm1: transfer 1 of 1")


def test_open_h_has_modalities_instructions_and_its_names(trials, tmp_path):
    export_lerobot(trials, tmp_path, layout="open-h", truth=True)
    info, modality = loaded(tmp_path / "meta" / "info.json"), loaded(tmp_path / "meta" / "modality.json")
    assert info["codebase_version"] == "v2.1"
    names = info["features"][STATE]["names"]
    for name, part in modality["state"].items():
        assert all(one.startswith("psm1") for one in names[part["start"] : part["end"]]), name
    assert modality["action"]["psm1_jaw"] == {"start": 7, "end": 8, "original_key": ACTION, "absolute": True}
    assert modality["state"]["psm1_orientation"]["rotation_type"] == "quaternion"
    assert modality["video"] == {"overhead": {"original_key": CAMERA}}
    assert modality["annotation"]["human.task_description"] == {"original_key": "task_index"}
    assert frames(tmp_path)[0]["instruction.text"][30].as_py().startswith("psm1: transfer 1 of 1")
    rows = [json.loads(line) for line in (tmp_path / "meta" / "episodes.jsonl").read_text().splitlines()]
    assert [row["success"] for row in rows] == [True, False, True]
    stats = [json.loads(line) for line in (tmp_path / "meta" / "episodes_stats.jsonl").read_text().splitlines()]
    assert [one["episode_index"] for one in stats] == [0, 1, 2]
    assert (tmp_path / "meta" / "README.md").is_file() and "truth.poses" in info["features"]


def test_what_is_there_is_not_written_again_and_an_interrupted_export_continues(trials, tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        export_lerobot(interrupted(trials), tmp_path)
    assert not (tmp_path / "meta" / "info.json").exists()
    wrote = []
    write_video = dataset.write_video
    monkeypatch.setattr(dataset, "write_video", lambda path, *rest: wrote.append(path.name) or write_video(path, *rest))
    export_lerobot(trials, tmp_path)
    first = {path: path.stat().st_mtime_ns for path in (tmp_path / "data").rglob("*.parquet")}
    assert len(first) == 3
    wrote.clear()
    export_lerobot(trials, tmp_path)
    assert wrote == [] and {path: path.stat().st_mtime_ns for path in first} == first
    next((tmp_path / "videos").rglob("file-001.mp4")).unlink()
    export_lerobot(trials, tmp_path)
    assert wrote == ["file-001.mp4"]


def test_a_trial_that_was_run_again_is_written_again(trials, tmp_path):
    export_lerobot(trials[:1], tmp_path)
    moved = {**trials[0].arrays, "desired_psm1": trials[0].arrays["desired_psm1"] + np.float32(0.01)}
    again = replace(trials[0], arrays=moved)
    export_lerobot([again], tmp_path)
    written = np.array(frames(tmp_path)[0][ACTION].to_pylist(), np.float32)
    assert np.array_equal(written, episode_of(again).columns[ACTION])


def test_a_data_set_that_is_being_changed_is_none(trials, tmp_path):
    export_lerobot(trials[:2], tmp_path)
    with pytest.raises(KeyboardInterrupt):
        export_lerobot(interrupted(trials[:2]), tmp_path, commanded=True)
    assert not (tmp_path / "meta" / "info.json").exists(), "it would be read, half old and half new"


def test_a_trial_that_stopped_at_once_is_left_out_and_counted(trials, tmp_path):
    cut = {k: v[:3] if k != "T_world_board" else v for k, v in trials[1].arrays.items()}
    tiny = replace(trials[1], arrays=cut)
    done = export_lerobot([trials[0], tiny, trials[2]], tmp_path)
    assert (done.episodes, done.left_out, done.short) == (2, 0, 1)
    with pytest.raises(InvalidInput, match="no trial of two frames or more"):
        export_lerobot([tiny], tmp_path / "none")


def test_pushes_are_not_taught_as_commands(trials, tmp_path):
    """A policy for raw cables would learn to drift on, where noise had pushed its teacher."""
    pushed = replace(trials[0], about={**trials[0].about, "command_noise": 2.0})
    export_lerobot([pushed], tmp_path / "asked")
    with pytest.raises(InvalidInput, match="would teach the pushes of --command-noise"):
        export_lerobot([pushed], tmp_path / "sent", commanded=True)


def test_failures_can_be_left_out_and_nothing_of_an_earlier_export_stays(trials, tmp_path):
    export_lerobot(trials, tmp_path)
    done = export_lerobot(trials, tmp_path, successes=True)
    assert (done.episodes, done.left_out) == (2, 1)
    assert len(frames(tmp_path)) == 2 == len(list((tmp_path / "videos").rglob("*.mp4")))
    assert frames(tmp_path)[1]["index"][0].as_py() == 91
    kept = episode_of(trials[2]).columns[ACTION]
    assert np.array_equal(np.array(frames(tmp_path)[1][ACTION].to_pylist(), np.float32), kept)
    export_lerobot(trials, tmp_path, commanded=True)
    sent = episode_of(trials[0], commanded=True).columns[ACTION]
    assert np.array_equal(np.array(frames(tmp_path)[0][ACTION].to_pylist(), np.float32), sent)
    with pytest.raises(InvalidInput, match="no trial that reached all its goals; keep trials"):
        export_lerobot(trials[1:2], tmp_path / "none", successes=True)


@pytest.mark.parametrize(("first", "then"), [("lerobot", "open-h"), ("open-h", "lerobot")])
def test_nothing_of_an_export_in_another_layout_stays(trials, tmp_path, first, then):
    for place, layouts in (("both", (first, then)), ("one", (then,))):
        for layout in layouts:
            export_lerobot(trials[: 1 if layout == then else 2], tmp_path / place, layout=layout)
    both, one = (
        {p.relative_to(top) for p in top.rglob("*") if p.is_file()} for top in (tmp_path / "both", tmp_path / "one")
    )
    assert both == one


def test_a_folder_of_somebody_else_is_not_touched(trials, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BadFile, match="holds files, but no data set of episodes that Trocar wrote"):
        export_lerobot(trials, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_trials_that_do_not_fit_together_and_unknown_layouts_are_refused(trials, tmp_path):
    with pytest.raises(InvalidInput, match="session 0, trial 1 differs from those before it in its cameras"):
        export_lerobot([trials[0], short(1, width=80)], tmp_path / "a")
    with pytest.raises(InvalidInput, match="differs from those before it in its cameras"):
        export_lerobot([trials[0], short(1, images=False)], tmp_path / "b")
    with pytest.raises(UnknownName, match="rlds"):
        export_lerobot(trials, tmp_path / "c", layout="rlds")


def test_a_run_without_images_has_no_videos(tmp_path):
    export_lerobot([short(images=False)], tmp_path)
    assert not (tmp_path / "videos").exists()
    assert loaded(tmp_path / "meta" / "info.json")["features"].keys() >= {STATE, ACTION}


def test_the_same_trials_are_the_same_bytes(trials, tmp_path):
    for name in ("a", "b"):
        export_lerobot(trials[:1], tmp_path / name)
    files = [path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file()]
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file
