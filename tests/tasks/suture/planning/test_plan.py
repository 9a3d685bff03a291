"""Plans as plain values: what is written is read back exactly, and nothing else is read."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.arms import ARMS
from trocar.errors import TrocarError
from trocar.files.output import write_json
from trocar.geometry import SE3
from trocar.tasks.suture.planning import PRESETS, Insertion, dexterity, plan_even, sutures_at
from trocar.tasks.suture.planning.parameters import SEARCHED, with_parameters
from trocar.tasks.suture.planning.plan import load_plan, setup_from, setup_values
from trocar.tasks.suture.planning.summary import plan_summary
from trocar.tasks.suture.planning.waypoints import waypoints, waypoints_values

PRESET = PRESETS["default"]
FOUND = dexterity(PRESET.setup, PRESET.reward, 36)
PLAN = plan_even(FOUND)
GOOD = json.loads(json.dumps(plan_summary(FOUND, PLAN)))

REFLECTED = np.diag([1.0, 1.0, -1.0, 1.0]).tolist()
SCALED = np.diag([1.001, 1.0, 1.0, 1.0]).tolist()
SKEWED_BELOW = [*np.eye(4)[:3].tolist(), [0.0, 0.0, 0.1, 1.0]]


def any_setup(seed):
    """Return a setup in which nothing is as it is by default."""
    rng = np.random.default_rng(seed)
    values = {name: rng.uniform(*bounds) for name, bounds in SEARCHED.items() if not name.startswith("center")}
    setup = with_parameters(PRESET.setup, values)
    pose = SE3.exp(rng.uniform(-3.0, 3.0, 6) * [0.1, 0.1, 0.1, 1, 1, 1])
    return replace(
        setup,
        arm=list(ARMS.values())[rng.integers(len(ARMS))],
        T_world_base=SE3.exp(rng.uniform(-0.1, 0.1, 6)) @ setup.T_world_base,
        circle=replace(setup.circle, T_world_circle=pose),
        needle=replace(setup.needle, wire_m=float(rng.uniform(2e-4, 2e-3))),
        insertion=Insertion(0.5, rng.uniform(0.002, 0.008), 1.2, 0.6, pushes=int(rng.integers(2)), theta_is="middle"),
    )


@given(seed=st.integers(0, 2**32 - 1))
def test_a_setup_is_read_back_to_the_last_bit(seed):
    setup = any_setup(seed)
    text = json.dumps(setup_values(setup))
    again = setup_from(json.loads(text))
    assert again.arm is setup.arm
    assert np.array_equal(again.T_world_base.matrix, setup.T_world_base.matrix)
    assert np.array_equal(again.circle.T_world_circle.matrix, setup.circle.T_world_circle.matrix)
    assert again.circle.radius_m == setup.circle.radius_m
    assert (again.needle, again.grasp, again.insertion) == (setup.needle, setup.grasp, setup.insertion)
    assert json.dumps(setup_values(again)) == text


def test_a_saved_plan_is_that_plan(tmp_path):
    (tmp_path / "plan.json").write_text(json.dumps(GOOD))
    found = load_plan(tmp_path / "plan.json")
    np.testing.assert_allclose(found.positions_rad, PLAN.positions_rad, atol=1e-11)
    assert found.directions.tolist() == PLAN.directions.tolist()
    assert np.array_equal(found.setup.T_base_circle.matrix, PRESET.setup.T_base_circle.matrix)
    assert [s.theta_rad for s in found.sutures] == found.positions_rad.tolist()
    assert [s.direction for s in found.sutures] == found.directions.tolist()
    assert json.loads(json.dumps(found.values())) == found.values()


def changed(keys, value):
    """Return a good plan with one value in another place's stead; ``...`` takes it away."""
    values = copy.deepcopy(GOOD)
    inner = values
    for key in keys[:-1]:
        inner = inner[key]
    if value is ...:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    return values


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("setup",), ..., "no key 'setup'; plan again with `trocar plan suture --out DIR`"),
        (("positions_deg",), ..., "no key 'positions_deg'"),
        (("directions",), [1, -1, 1], r"positions \(4,\) and directions \(3,\)"),
        (("directions",), [1, -1, 1, 2], r"directions.*give 1 \(clockwise\) or -1"),
        (("directions",), [1, -1, 1, True], "directions is True; give finite numbers"),
        (("positions_deg",), [0.0, 90.0, 180.0, float("nan")], "positions_deg is nan; give finite numbers"),
        (("positions_deg",), [0.0, 90.0, 180.0, 361.0], "361.*give 0 to 360 deg"),
        (("positions_deg",), "0 90", "positions_deg is '0 90'; give a list of numbers"),
        (("setup",), [1, 2], r"setup is \[1, 2\]; give a table of arm, T_world_base"),
        (("setup", "arm"), "psm-xi", "setup.arm is 'psm-xi'; choose one of psm-classic"),
        (("setup", "needle"), ..., "setup has no key 'needle'"),
        (("setup", "thread"), 1, "setup has an unknown key 'thread'; give arm, T_world_base"),
        (("setup", "needle", "colour"), "red", "setup.needle has an unknown key 'colour'; give radius_m, arc_rad"),
        (("setup", "grasp", "skew_rad"), float("inf"), "setup.grasp.skew_rad is inf; give finite numbers"),
        (("setup", "insertion", "pushes"), 1.5, "setup.insertion.pushes is 1.5; give a whole number"),
        (("setup", "insertion", "theta_is"), 3, "setup.insertion.theta_is is 3; give a word"),
        (("setup", "insertion", "theta_is"), "end", "choose one of entry, middle"),
        (("setup", "circle", "radius_m"), 0.9, "circle radius is 900 mm; give 2 to 200 mm"),
        (("setup", "circle", "radius_m"), 0.01, "too large for a circle"),
        (("setup", "T_world_base"), REFLECTED, "setup.T_world_base is not a rigid pose"),
        (("setup", "T_world_base"), SCALED, "setup.T_world_base is not a rigid pose"),
        (("setup", "circle", "T_world_circle"), SKEWED_BELOW, "setup.circle.T_world_circle is not a rigid pose"),
        (("setup", "T_world_base"), np.eye(4)[:3].tolist(), "four rows of four numbers"),
        (("setup", "T_world_base"), [*np.eye(4)[:3].tolist(), [0, 0, 0, None]], "is None; give finite numbers"),
    ],
)
def test_what_is_no_plan_is_refused_in_a_sentence(tmp_path, keys, value, words):
    (tmp_path / "plan.json").write_text(json.dumps(changed(keys, value)))
    with pytest.raises(TrocarError, match=words) as caught:
        load_plan(tmp_path / "plan.json")
    assert str(tmp_path / "plan.json") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not JSON; give the plan.json of `trocar plan suture --out DIR`"),
        (b"\xff\xfe\x00", "is not JSON"),
        (b"[" * 100_000, "is not JSON"),
        (b"[1, 2]", "holds no plan"),
        (b'{"setup": {}, "positions_deg": [], "directions": []}', "setup has no key 'T_world_base'"),
        (None, r"plan.json' cannot be read .*give the plan.json"),
    ],
)
def test_a_file_of_something_else_or_none_is_named(tmp_path, content, words):
    if content is not None:
        (tmp_path / "plan.json").write_bytes(content)
    with pytest.raises(TrocarError, match=words):
        load_plan(tmp_path / "plan.json")


def places(values, keys=()):
    """Return the keys of every value in a tree of tables."""
    inner = values.items() if isinstance(values, dict) else ()
    return [place for key, value in inner for place in ((*keys, key), *places(value, (*keys, key)))]


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=20,
)


@given(st.sampled_from(places(GOOD["setup"])), JUNK)
def test_whatever_stands_in_a_setup_it_is_one_or_a_sentence_says_why_not(keys, junk):
    try:
        again = setup_values(setup_from(changed(("setup", *keys), junk)["setup"]))
    except TrocarError as error:
        assert "\n" not in str(error)
    else:
        for key in keys:
            again = again[key]
        assert again == junk


@pytest.fixture
def saved(tmp_path):
    """Return where a plan's folder is, and what its waypoints hold."""
    map = dexterity(PRESET.setup, PRESET.reward)
    plan = plan_even(map, 2)
    summary = plan_summary(map, plan)
    stitches = [waypoints(suture) for suture in sutures_at(PRESET.setup, plan.positions_rad, plan.directions)]
    values = {name: summary[name] for name in ("setup", "positions_deg", "directions")}
    write_json(tmp_path / "plan.json", summary, "plan of sutures")
    write_json(tmp_path / "waypoints.json", {**values, **waypoints_values(stitches)}, "waypoints of sutures")
    return tmp_path, json.loads((tmp_path / "waypoints.json").read_text())


def test_a_folder_its_plan_and_its_waypoints_are_the_same_plan(saved):
    folder, _ = saved
    of_folder, of_plan, of_waypoints = map(load_plan, (folder, folder / "plan.json", folder / "waypoints.json"))
    assert of_folder.values() == of_plan.values() == of_waypoints.values()


@pytest.mark.parametrize(
    "change",
    [
        lambda values: values["stitches"][0]["joints"][5].__setitem__(3, 0.5),
        lambda values: values["stitches"].pop(),
        lambda values: values["stitches"][1]["times_s"].pop(),
        lambda values: values["stitches"][1].pop("jaw_rad"),
        lambda values: values["stitches"][1].__setitem__("segments", "rotate"),
        lambda values: values.__setitem__("directions", [-sign for sign in values["directions"]]),
        lambda values: values.__setitem__("stitches", None),
        lambda values: values["stitches"][0]["joints"][5].__setitem__(3, "a"),
    ],
)
def test_waypoints_that_are_not_those_of_their_plan_are_refused(saved, change):
    folder, values = saved
    change(values)
    (folder / "waypoints.json").write_text(json.dumps(values))
    with pytest.raises(TrocarError, match="holds waypoints that are not those of its plan; an arm follows the plan"):
        load_plan(folder / "waypoints.json")
