"""Data sets that are read: their own, others', and what is wrong with one in a sentence."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from made_episodes import short
from trocar.errors import TrocarError
from trocar.learn.dataset import export_lerobot
from trocar.learn.episode import ACTION, STATE, episode_of
from trocar.learn.read import read_episode

TRIALS = (0, 1)


@pytest.fixture(scope="module", params=["lerobot", "open-h"])
def exported(request, tmp_path_factory):
    place = tmp_path_factory.mktemp(request.param)
    export_lerobot([short(k) for k in TRIALS], place, layout=request.param)
    return place


@pytest.fixture
def folder(exported, tmp_path):
    """A data set that a test may spoil."""
    return shutil.copytree(exported, tmp_path / "data")


def changed_info(folder, **changes):
    path = folder / "meta" / "info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def changed_table(folder, change):
    path = sorted((folder / "data").rglob("*.parquet"))[1]
    pq.write_table(change(pq.read_table(path)), path)


def with_column(table, key, values):
    return table.set_column(table.column_names.index(key), key, values)


def test_what_was_written_is_read(folder):
    for number in TRIALS:
        recorded, episode = read_episode(folder, number), episode_of(short(number))
        assert (recorded.fps, recorded.frames, list(recorded.actions)) == (30.0, 91, ["psm1"])
        assert np.array_equal(recorded.actions["psm1"], episode.columns[ACTION].astype(float))
        assert np.array_equal(recorded.states["psm1"], episode.columns[STATE].astype(float))


def test_names_in_another_order_and_nested_as_open_h_nests_them_are_read(folder):
    features = json.loads((folder / "meta" / "info.json").read_text())["features"]
    turned = features[ACTION]["names"][::-1]
    features[ACTION]["names"] = [["other", *turned]]

    def turn(table):
        values = np.array(table[ACTION].to_pylist())[:, ::-1]
        return with_column(table, ACTION, pa.array(np.column_stack([np.zeros(len(values)), values]).tolist()))

    changed_info(folder, features=features)
    changed_table(folder, turn)
    expected = episode_of(short(1)).columns[ACTION]
    np.testing.assert_allclose(read_episode(folder, 1).actions["psm1"], expected, atol=1e-7)


def test_a_data_set_without_states_has_none(folder):
    changed_table(folder, lambda table: table.drop_columns([STATE]))
    assert read_episode(folder, 1).states == {}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.drop_columns([ACTION]), "lacks the column 'action'"),
        (lambda t: t.drop_columns(["timestamp"]), "lacks the column 'timestamp'"),
        (lambda t: t.drop_columns(["episode_index"]), "lacks the column 'episode_index'"),
        (lambda t: t.slice(0, 50), "has 50 frames of episode 1, and its list of episodes says 91"),
        (
            lambda t: with_column(t, "timestamp", pa.array(np.arange(91) / 10, pa.float32())),
            "has frames at 10 Hz by their timestamps, and meta/info.json says 30 Hz",
        ),
        (
            lambda t: with_column(t, ACTION, pa.array([[float("nan")] * 8] * 91)),
            "has a 'action' that is not finite in frame 0",
        ),
        (lambda t: with_column(t, ACTION, pa.array([[0.0] * 7] * 91)), "'action' that is not 8 numbers a frame"),
        (lambda t: with_column(t, ACTION, pa.array(["x"] * 91)), "'action' that is not 8 numbers a frame"),
    ],
)
def test_what_is_wrong_with_frames_is_told(folder, change, says):
    changed_table(folder, change)
    with pytest.raises(TrocarError) as refusal:
        read_episode(folder, 1)
    assert says in str(refusal.value) and str(refusal.value).count("\n") == 0
    read_episode(folder, 0)


def test_another_rate_in_info_is_told(folder):
    changed_info(folder, fps=50)
    with pytest.raises(TrocarError, match=r"has frames at 30 Hz by their timestamps, and meta/info.json says 50 Hz"):
        read_episode(folder)


def test_a_line_of_other_text_in_the_list_of_episodes_does_not_matter(exported, folder):
    listed = folder / "meta" / "episodes.jsonl"
    if listed.is_file():
        listed.write_bytes(b'{"episode_index": 9, "tasks": ["n\xe4hen"]}\n' + listed.read_bytes())
    assert read_episode(folder, 1).frames == 91


def test_a_column_of_another_kind_is_told_as_such(folder):
    changed_table(folder, lambda t: with_column(t, "episode_index", pa.array(["1"] * 91)))
    with pytest.raises(TrocarError, match=r"a column 'episode_index' of type string, which must be whole numbers"):
        read_episode(folder, 1)
    for listed in (folder / "meta").rglob("file-*.parquet"):
        table = pq.read_table(listed)
        key = "data/file_index"
        pq.write_table(with_column(table, key, pa.array(["0"] * len(table))), listed)
        with pytest.raises(TrocarError, match=rf"{listed.name}' has a column '{key}' of type string, which must be"):
            read_episode(folder, 1)


@pytest.mark.parametrize("kept", [0, 4, 1000, -20])
def test_a_cut_file_is_told(folder, kept):
    path = sorted((folder / "data").rglob("*.parquet"))[0]
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(TrocarError, match=r"is no Parquet file that can be read: it may be cut; fetch"):
        read_episode(folder)


def test_a_missing_file_is_told(folder):
    sorted((folder / "data").rglob("*.parquet"))[0].unlink()
    with pytest.raises(TrocarError, match="is missing; fetch the data set again"):
        read_episode(folder)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"fps": None}, r"has no fps that can be used \(None\)"),
        ({"fps": -5}, "says -5 frames a second"),
        ({"codebase_version": "v1.6"}, "is of format v1.6, and v2.0 to v3.x can be read"),
        ({"data_path": "data/{nothing}.parquet"}, "that names no file"),
        ({"data_path": "data/{episode_index.x}.parquet"}, "that names no file"),
        ({"chunks_size": 0}, "says 0 episodes in a chunk"),
        ({"chunks_size": "many"}, r"has no chunks_size that can be used \('many'\)"),
        ({"features": {}}, "lacks the feature 'action'"),
        ({"features": {"action": {"names": 5}}}, "names the numbers of 'action' 5"),
        ({"features": {"action": {"names": ["j1", "j2"]}}}, "are j1, j2: no set-points of an arm"),
        ({"features": {"action": {"names": ["a_sp.position.x", *"bcdefgh"]}}}, "has no 'a_sp.position.y'"),
        ({"total_episodes": 1}, "--episode"),
        ({"total_episodes": 0}, "says that it has 0 episodes"),
    ],
)
def test_what_is_wrong_with_info_is_told(folder, changes, says):
    changed_info(folder, **changes)
    with pytest.raises(TrocarError, match=says):
        read_episode(folder, 1)


def test_a_folder_without_a_data_set_and_broken_lists_are_told(folder, tmp_path_factory):
    with pytest.raises(TrocarError, match=r"has no meta/info.json"):
        read_episode(tmp_path_factory.mktemp("empty"))
    for listed in (*(folder / "meta").rglob("file-*.parquet"), *(folder / "meta").glob("episodes.jsonl")):
        listed.write_bytes(listed.read_bytes()[:10])
    with pytest.raises(TrocarError, match=r"it may be cut|does not list episode 0"):
        read_episode(folder)
    (folder / "meta" / "info.json").write_text("{")
    with pytest.raises(TrocarError, match="is not readable JSON"):
        read_episode(folder)
