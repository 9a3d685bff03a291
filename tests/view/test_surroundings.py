"""A table lies below everything, and a ring stands where each shaft passes."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_up_replay import made_up_replay, still_replay
from trocar.arms import PSM_CLASSIC
from trocar.geometry import SE3
from trocar.view.film import shoot
from trocar.view.surroundings import add_ports, lay_table, ring

REPLAY = made_up_replay(6.0)


class Meshes(dict):
    """Takes meshes as viser's scene does: position and corners in the world, by name."""

    def add_mesh_simple(self, name, vertices, faces, position, **look):
        self[name] = np.asarray(position), vertices + np.asarray(position)


def test_the_table_is_below_what_stands_on_it_and_reaches_beyond_objects_and_ports():
    film, scene = shoot(REPLAY), Meshes()
    lay_table(scene, REPLAY, film)
    _, corners = scene["/table"]
    assert corners[:, 2].max() == pytest.approx(-0.0245, abs=1e-6)  # half a millimetre below the board's box
    blocks = film.position_m[[name.startswith("block") for name in film.bodies]].reshape(-1, 3)
    around = np.concatenate([blocks, list(REPLAY.ports_m.values())])[:, :2]
    assert (corners[:, :2].min(0) < around.min(0)).all()
    assert (corners[:, :2].max(0) > around.max(0)).all()


def test_objects_that_lie_beside_the_board_lie_on_the_table_too():
    far = SE3.from_parts(None, np.tile([0.0, -0.6, 0.0], (len(REPLAY.times_s), 1)))
    replay, scene = replace(REPLAY, T_world_body={**REPLAY.T_world_body, "block5": far}), Meshes()
    lay_table(scene, replay, shoot(replay))
    assert scene["/table"][1][:, 1].min() < -0.6


def test_without_anything_fixed_there_is_no_table():
    replay, scene = replace(REPLAY, solids=tuple(s for s in REPLAY.solids if s.body != "world")), Meshes()
    lay_table(scene, replay, shoot(replay))
    assert scene == {}


@pytest.mark.parametrize("replay", [REPLAY, replace(still_replay(), ports_m={"psm1": REPLAY.ports_m["psm1"]})])
def test_the_shaft_passes_through_the_ring_at_its_remote_centre(replay):
    scene = Meshes()
    add_ports(scene, replay, shoot(replay))
    for arm, port_m in replay.ports_m.items():
        position, corners = scene[f"/ports/{arm}"]
        assert_allclose(position, port_m)
        wrist = replay.T_world_body[f"{arm}_link4"].translation_m.reshape(-1, 3)
        for at in wrist[:: max(1, len(wrist) // 50)]:
            along = (port_m - at) / np.linalg.norm(port_m - at)
            from_axis = np.linalg.norm(np.cross(corners - port_m, along), axis=1)
            assert from_axis.min() > PSM_CLASSIC.instrument.shaft_radius_m


def test_an_arm_whose_wrist_nobody_knows_has_no_ring():
    scene = Meshes()
    add_ports(scene, replace(REPLAY, ports_m={"psm3": np.zeros(3)}), shoot(REPLAY))
    assert scene == {}


def test_a_ring_is_round_and_across_its_axis():
    axis = np.array([1.0, 2.0, -0.5])
    corners = ring(8e-3, 2e-3, axis).vertices_m
    along = corners @ axis / np.linalg.norm(axis)
    away = np.linalg.norm(corners - np.outer(along, axis / np.linalg.norm(axis)), axis=1)
    assert np.abs(along).max() == pytest.approx(2e-3, rel=0.05)
    assert [away.min(), away.max()] == pytest.approx([6e-3, 10e-3], rel=0.05)
