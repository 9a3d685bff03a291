"""The scene of a trial's cell, drawn again without simulator, task or arm model."""

import json
from dataclasses import asdict, replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated import Hand, ideal_session, joints_at, scene_of, standing, trial_of
from trocar.arms import ARMS, fk
from trocar.errors import TrocarError
from trocar.eval.scenery import Scenery, arm_of, link_poses
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.lab.session import draw_session
from trocar.replay import SHAPES
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.world import World
from trocar.tasks.peg_transfer.world import PegWorld

EVERY_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
T_WORLD_BASE = SE3.from_parts(SO3.exp([0.3, -0.7, 1.1]), [0.1, -0.2, 0.4])
SINGLE_PRECISION_M = 1e-6


@EVERY_ARM
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_the_bodies_of_an_arm_are_where_mujoco_has_them_even_from_single_precision(arm, seed):
    rng = np.random.default_rng(seed)
    world = World({"only": arm}, {"only": T_WORLD_BASE})
    joints = np.append(rng.uniform(arm.lower, arm.upper), rng.uniform(0.0, arm.jaw.upper))
    world.place_arm("only", joints[:6], joints[6])
    found = link_poses("only", arm, T_WORLD_BASE, joints[None].astype(np.float32).astype(np.float64))
    bodies = {world.model.body(b).name for b in range(world.model.nbody)} - {"world", "only_base"}
    assert set(found) == bodies
    for body in bodies:
        assert np.abs(found[body].matrix[0] - world.pose(body).matrix).max() < SINGLE_PRECISION_M, body


class Watched(PegWorld):
    """A board whose physics' whole state is kept at every tick."""

    def __init__(self, scene):
        super().__init__(scene)
        self.states = []

    def observe(self, time_s):
        super().observe(time_s)
        self.states.append(self._world.data.qpos.copy())


@pytest.fixture(scope="module")
def played():
    """A laboratory in which one arm lifted a block, ran it into a peg and took a picture; and its trial."""
    lab = SimLaboratory(ideal_session(), Watched(scene_of(standing(1), standing(4))), np.random.default_rng(0))

    async def script(cell):
        hand = Hand(lab)
        with cell.log.span("psm1", "motion"):
            await hand.grasp(0)
            await hand.shift([0.0, 0.0, 0.018])
            await hand.shift([0.015, 0.0, 0.0])
        cell.log.event("hit", by="hand")
        await cell.cameras["overhead"].capture()

    assert lab.run(script, 30.0)
    return lab, trial_of(lab, task="peg-transfer", variant="unilateral")


def test_every_body_of_a_replay_is_where_it_was(played):
    lab, trial = played
    poses = trial.replay().T_world_body
    model, data = lab.world.model, mujoco.MjData(lab.world.model)
    assert set(poses) == {model.body(b).name for b in range(model.nbody)}
    loosely = {f"{arm}_finger_right" for arm in lab.world.arms}
    for row in range(0, len(trial.times_s), 37):
        data.qpos[:] = lab.task.states[row]
        mujoco.mj_kinematics(model, data)
        for body, T in poses.items():
            matrix = T.matrix if T.matrix.ndim == 2 else T.matrix[row]
            at = data.body(body)
            # the right finger is mirrored from the left one, which the physics couples with a stiff spring
            tolerance = 5e-3 if body in loosely else SINGLE_PRECISION_M
            assert np.abs(matrix[:3, 3] - at.xpos).max() < SINGLE_PRECISION_M, body
            assert np.abs(matrix[:3, :3] - at.xmat.reshape(3, 3)).max() < tolerance, body


def test_every_solid_has_a_body_and_a_shape_that_can_be_drawn(played):
    _, trial = played
    replay = trial.replay()
    assert {solid.body for solid in replay.solids} <= set(replay.T_world_body)
    assert {solid.shape for solid in replay.solids} <= set(SHAPES)
    bodies = {"board", "block0", "block1", *(f"{arm}_finger_left" for arm in ("psm1", "psm2"))}
    assert bodies <= {solid.body for solid in replay.solids}
    for solid in replay.solids:
        assert (len(solid.vertices_m) >= 4) == (solid.shape == "hull")
        assert all(size > 0 for size in solid.size_m) and 0 < solid.rgba[3] <= 1


def test_a_replay_says_what_the_arrays_say(played):
    lab, trial = played
    replay = trial.replay()
    count = len(lab.record().times_s)
    assert np.allclose(replay.times_s, lab.record().times_s, atol=1e-12) and len(replay.times_s) == count
    assert replay.title == "peg-transfer unilateral by hand"
    for body in ("block0", "block1"):
        rows = trial.arrays[f"body_{body}"]
        assert np.array_equal(replay.T_world_body[body].translation_m, rows[:, :3])
        assert np.abs(replay.T_world_body[body].matrix - lab.record().T_world_body[body].matrix).max() < 1e-6
    for arm in ("psm1", "psm2"):
        assert set(replay.joints[arm]) == {"desired", "commanded", "measured", "true"}
        for kind, rows in replay.joints[arm].items():
            assert np.array_equal(rows, trial.arrays[f"{kind}_{arm}"])
        assert replay.joint_names[arm] == (*(joint.name for joint in lab.cell.arms[arm].joints), "jaw")
        driven = lab.record().T_world_tip[arm].translation_m
        assert np.abs(replay.tools[arm].p_world_driven_m - driven).max() < 1e-6
    assert replay.events == tuple(trial.events) and replay.events[-1]["name"] == "hit"
    assert replay.spans == (("psm1", "motion", 0.0, pytest.approx(replay.events[-1]["time_s"])),)


def test_a_replay_has_the_contacts_and_the_images(played):
    lab, trial = played
    replay = trial.replay()
    held = [contact for contact in replay.contacts if contact.between == ("psm1: held block", "peg 1")]
    assert held and len(replay.contacts) == len(lab.record().collisions)
    first = next(c for c in lab.record().collisions if c.what == "held block")
    assert (held[0].time_s, held[0].end_s, held[0].force_n) == (first.time_s, first.end_s, first.force_n)
    assert held[0].p_world_m == first.p_world_m
    (image,) = replay.images
    assert image.camera == "overhead" and image.encoded[:4] == b"RIFF"
    assert image.time_s == pytest.approx(lab.cameras["overhead"].taken[0].time_s)


def test_tools_are_planned_with_what_registration_found_and_driven_where_the_arm_is():
    station = load_station("peg-transfer")
    session = draw_session(station, np.random.default_rng(4))
    lab = SimLaboratory(session, rng=np.random.default_rng(0))
    goal = joints_at("psm1", (0.02, 0.01, 0.06))

    async def script(cell):
        del cell
        await Hand(lab).go(goal)

    lab.run(script, 10.0)
    tool = trial_of(lab).replay().tools["psm1"]
    arm = station.arms["psm1"].model
    planned = (session.T_world_base_registered["psm1"] @ fk(arm, goal)).translation_m
    driven = (session.T_world_base["psm1"] @ fk(arm, lab.world.joints("psm1"))).translation_m
    assert np.abs(tool.p_world_planned_m[-1] - planned).max() < 1e-6
    assert np.abs(tool.p_world_driven_m[-1] - driven).max() < 1e-6
    assert np.linalg.norm(planned - driven) > 0.5e-3


def same(first, second):
    assert type(first) is type(second)
    if isinstance(first, SE3):
        first, second = first.matrix, second.matrix
    if isinstance(first, np.ndarray):
        assert np.array_equal(first, second)
    elif isinstance(first, dict):
        assert first.keys() == second.keys()
        for key, value in first.items():
            same(value, second[key])
    elif isinstance(first, tuple | list):
        assert len(first) == len(second)
        for a, b in zip(first, second, strict=True):
            same(a, b)
    elif hasattr(first, "__dataclass_fields__"):
        for name in first.__dataclass_fields__:
            same(getattr(first, name), getattr(second, name))
    else:
        assert first == second


def test_scenery_comes_back_from_its_values(played):
    _, trial = played
    values = trial.scenery.values()
    back = Scenery.of(json.loads(json.dumps(values, allow_nan=False)))
    assert back.values() == values
    same(replace(trial, scenery=back).replay().solids[0].T_body_solid, trial.scenery.solids[0].T_body_solid)
    for name in ("arms", "T_world_base", "T_world_base_registered", "T_world_body", "cameras"):
        same(dict(getattr(back, name)), dict(getattr(trial.scenery, name)))
    for first, second in zip(back.solids, trial.scenery.solids, strict=True):
        assert np.abs(first.vertices_m - second.vertices_m).max(initial=0.0) <= 0.5e-9
        same(replace(first, vertices_m=second.vertices_m), second)


def test_a_trial_that_was_saved_has_the_same_replay(played, tmp_path):
    _, trial = played
    loaded = type(trial).load(trial.save(tmp_path / "trial.npz")).replay()
    replay = trial.replay()
    for name in ("title", "times_s", "tools", "contacts", "spans", "events", "joints", "joint_names", "images"):
        same(getattr(loaded, name), getattr(replay, name))
    same(dict(loaded.T_world_body), dict(replay.T_world_body))


@EVERY_ARM
def test_an_arm_comes_back_from_its_values(arm):
    back = arm_of(json.loads(json.dumps(asdict(arm), allow_nan=False)))
    assert back == arm
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper)
    assert np.array_equal(fk(back, q).matrix, fk(arm, q).matrix)


def test_an_arm_with_other_parts_is_refused():
    values = asdict(ARMS["psm-classic"])
    fewer = {name: value for name, value in values.items() if name != "joints"}
    for other, wrong in (
        (values | {"wheels": 4}, "wheels"),
        (fewer, "joints"),
        (values | {"joints": 3}, "valid tuple"),
    ):
        with pytest.raises(TrocarError, match=rf"{wrong}.*damaged"):
            arm_of(other)
