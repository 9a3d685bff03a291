"""The set that ships is what its generator makes, says that it is synthetic, and looks like sutures."""

from importlib.resources import files

import numpy as np
from numpy.testing import assert_allclose

from trocar.arms import fk
from trocar.tasks.suture.demonstrations import load_manifest, synthetic_demonstrations
from trocar.tasks.suture.demonstrations.readers import read_recording
from trocar.tasks.suture.demonstrations.synthetic import (
    HOVER_M,
    PLACES,
    SEED,
    SETUP,
    WANDER_M,
    synthetic_suture,
    write_synthetic,
)
from trocar.tasks.suture.planning import dexterity

SHIPPED = files("trocar.tasks.suture.demonstrations") / "synthetic_set"


def test_two_sutures_at_each_of_eight_places_by_two_arms():
    demos = synthetic_demonstrations()
    assert_allclose(np.degrees(demos.places_rad), np.arange(0, 360, 45), atol=1e-9)
    assert demos.recordings.tolist() == [2] * PLACES
    assert demos.per_arm.shape == (2, PLACES)
    assert demos.source.startswith("synthetic")
    assert all("synthetic" in suture.file.name for suture in load_manifest(str(SHIPPED)).sutures)


def test_the_shipped_files_are_what_the_generator_writes(tmp_path):
    write_synthetic(tmp_path, np.random.default_rng(SEED))
    there, here = load_manifest(str(SHIPPED)), load_manifest(tmp_path)
    assert [suture.theta_rad for suture in there.sutures] == [suture.theta_rad for suture in here.sutures]
    for old, new in zip(there.sutures, here.sutures, strict=True):
        values = [np.asarray(read_recording(suture.file, there.convention)) for suture in (old, new)]
        assert_allclose(*values, atol=2e-4)


def test_the_set_is_small():
    assert sum(len(file.read_bytes()) for file in SHIPPED.iterdir()) < 60_000


def test_the_first_arm_works_where_the_suture_stands():
    for theta in np.arange(PLACES) * 2 * np.pi / PLACES:
        q = synthetic_suture(theta, np.random.default_rng(1))
        assert np.all((q >= SETUP.arm.lower) & (q <= SETUP.arm.upper))
        tip = (SETUP.T_world_base @ fk(SETUP.arm, q[:, 0])).translation_m
        entry = SETUP.circle.radius_m * np.array([np.cos(theta), np.sin(theta), 0.0])
        reach = 2 * SETUP.needle.radius_m + SETUP.insertion.straight_m + 6 * WANDER_M
        assert np.linalg.norm(tip - entry, axis=1).min() < reach
        assert np.linalg.norm((tip - entry)[0, :2]) < reach + HOVER_M


def test_it_steps_without_leaps():
    steps = [np.abs(np.diff(synthetic_suture(t, np.random.default_rng(5)), axis=0)).max((0, 1)) for t in (0.0, 2.0)]
    assert np.max(steps) < 1.0


def test_it_moves_manipulability_round_the_circle_as_the_primitive_alone_does_not():
    surrogate = dexterity(SETUP, positions=8).manipulability
    demos = synthetic_demonstrations().at_places
    assert demos.max() / demos.min() > 1.5
    assert not np.allclose(demos / demos.max(), surrogate / surrogate.max(), atol=0.1)
