"""An instrument is drawn where the kinematics of its arm put it."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS, capsules, frames
from trocar.arms.solids import parts_of
from trocar.geometry import SE3, SO3
from trocar.view.instrument import Instrument

BASE = SE3.from_parts(SO3.exp([0.2, -0.3, 0.4]), [0.02, -0.05, 0.3])
OPEN_RAD = 0.7


class Scene:
    """Keeps what is added by its name, as viser's scene would."""

    def __init__(self):
        self.nodes = {}

    def add_frame(self, name, **how):
        return self.nodes.setdefault(name, SimpleNamespace())

    def add_mesh_simple(self, name, vertices_m, faces, **how):
        return self.nodes.setdefault(name, SimpleNamespace(vertices_m=vertices_m))


def pose(node):
    return SE3.from_parts(SO3.from_quaternion(node.wxyz), node.position)


@pytest.fixture(params=sorted(ARMS))
def drawn(request):
    arm, scene = ARMS[request.param], Scene()
    q = 0.6 * arm.lower + 0.4 * arm.upper
    instrument = Instrument(scene, "/arm", arm)
    instrument.show(BASE, q, OPEN_RAD)
    return arm, q, instrument, scene


def test_every_part_hangs_on_its_link_and_every_link_is_at_its_frame(drawn):
    arm, q, instrument, scene = drawn
    assert {f"/arm/{part.link}/{part.name}" for part in parts_of(arm)} < scene.nodes.keys()
    for link, node in instrument.links.items():
        assert_allclose(pose(node).matrix, (BASE @ frames(arm, q))[link].matrix, atol=1e-9)


def test_fingers_open_as_far_as_asked_within_the_capsules_that_planning_takes_them_for(drawn):
    arm, q, instrument, _ = drawn
    left, right = (pose(instrument.fingers[side]) for side in ("left", "right"))
    assert np.arccos(left.rotation.matrix[:, 0] @ right.rotation.matrix[:, 0]) == pytest.approx(OPEN_RAD, abs=1e-7)
    solids = capsules(arm, q, OPEN_RAD).moved(BASE)
    for number, side in ((2, "left"), (3, "right")):
        drawn_m = pose(instrument.fingers[side]).apply(instrument.fingers[side].vertices_m.astype(float))
        start, end = solids.ends_m[number]
        along = np.clip((drawn_m - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
        away_m = np.linalg.norm(drawn_m - start - along[:, None] * (end - start), axis=1)
        assert away_m.max() < solids.radii_m[number] + 1e-6, side
