"""An instrument is drawn where the kinematics of its arm put it."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS, capsules, fk
from trocar.geometry import SE3, SO3
from trocar.view.instrument import Instrument

BASE = SE3.from_parts(SO3.exp([0.2, -0.3, 0.4]), [0.02, -0.05, 0.3])
OPEN_RAD = 0.7


class Scene:
    """Keeps the vertices of what is added, as viser's scene would."""

    def add_frame(self, name, **how):
        return SimpleNamespace(name=name, vertices_m=np.zeros((1, 3)))

    def add_mesh_simple(self, name, vertices_m, faces, **how):
        return SimpleNamespace(name=name, vertices_m=vertices_m)


def pose(node):
    return SE3.from_parts(SO3.from_quaternion(node.wxyz), node.position)


@pytest.fixture(params=sorted(ARMS))
def drawn(request):
    arm = ARMS[request.param]
    q = 0.6 * arm.lower + 0.4 * arm.upper
    instrument = Instrument(Scene(), "/arm", arm)
    instrument.show(BASE, q, OPEN_RAD)
    return arm, q, instrument.parts


def test_its_jaws_are_at_the_tip_and_open_as_far_as_asked(drawn):
    arm, q, parts = drawn
    assert_allclose(pose(parts["jaws"]).matrix, (BASE @ fk(arm, q)).matrix, atol=1e-9)
    left, right = (pose(parts[side]).rotation.matrix[:, 2] for side in ("left", "right"))
    assert np.arccos(left @ right) == pytest.approx(OPEN_RAD, abs=1e-7)


def test_its_parts_hang_together_and_the_shaft_comes_through_the_remote_centre(drawn):
    arm, _, parts = drawn
    shaft, wrist, jaws = (pose(parts[part]) for part in ("shaft", "wrist", "jaws"))
    assert_allclose(shaft.translation_m, wrist.translation_m, atol=1e-12)
    assert_allclose(jaws.apply([0.0, 0.0, arm.tip_length_m]), wrist.apply([arm.wrist_length_m, 0.0, 0.0]), atol=1e-12)
    line = shaft.apply([0.0, 0.0, arm.wrist_sign]) - shaft.translation_m
    to_centre = BASE.translation_m - shaft.translation_m
    assert_allclose(np.cross(line, to_centre), 0.0, atol=1e-12)
    assert line @ to_centre > 0


def test_it_is_drawn_within_the_capsules_that_planning_takes_it_for(drawn):
    """Each capsule holds the whole solid; the end of the shaft behind the port is drawn flat: its line is endless."""
    arm, q, parts = drawn
    solids = capsules(arm, q, OPEN_RAD).moved(BASE)
    for number, part in enumerate(("shaft", "wrist", "left", "right")):
        T = pose(parts[part]) if number < 2 else pose(parts["jaws"]) @ pose(parts[part])
        drawn_m = T.apply(parts[part].vertices_m.astype(float))
        start, end = solids.ends_m[number]
        along = (drawn_m - start) @ (end - start) / ((end - start) @ (end - start))
        along = along if part == "shaft" else np.clip(along, 0.0, 1.0)
        away_m = np.linalg.norm(drawn_m - start - along[:, None] * (end - start), axis=1)
        assert away_m.max() < solids.radii_m[number] + 1e-6, part
