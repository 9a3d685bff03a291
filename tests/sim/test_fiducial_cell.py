"""An arm that is calibrated hangs over a cleared black table that nothing collides with."""

from dataclasses import replace

import numpy as np
import pytest

from simulated import ideal_session
from trocar.errors import TrocarError
from trocar.lab import SensorFlaws
from trocar.perception.fiducials import SIX_SPHERES
from trocar.perception.image import StereoRig
from trocar.sim.calibration_cells import EmptyTable, FiducialCell
from trocar.sim.world import World


def day_with(**model):
    """A session whose camera has few pixels."""
    day = ideal_session()
    camera = day.station.cameras["overhead"]
    cameras = {"overhead": replace(camera, model=camera.model.binned(8), **model)}
    return replace(day, station=replace(day.station, cameras=cameras))


def test_the_table_is_black_and_below_the_work_and_stops_nothing():
    table = World({}, {}, EmptyTable()).model.geom("table")
    assert table.pos[:2].tolist() == [0.0, 0.0] and -0.12 < table.pos[2] < -0.04
    assert table.rgba[3] == 1.0 and table.rgba[:3].min() > 0.0 and table.rgba[:3].max() < 0.08
    assert table.contype[0] == table.conaffinity[0] == 0


@pytest.mark.parametrize("flaws", [None, SensorFlaws.none()])
def test_its_camera_has_the_stations_flaws_or_others(flaws):
    day, rng = day_with(), np.random.default_rng(0)
    cell = FiducialCell(day, "psm1", "overhead", SIX_SPHERES, rng, flaws)
    assert cell._camera.lenses[0].flaws == (flaws or day.station.cameras["overhead"].flaws)
    assert cell.fixture != SIX_SPHERES, "what was printed"
    q = day.station.arms["psm1"].park_q()
    image = cell.image(q, (5, 7), (20, 30), rng)
    assert image.depth_m.shape == (30, 20)


def test_a_camera_without_depth_is_refused():
    day = day_with()
    lens = day.station.cameras["overhead"].model
    rig = StereoRig(lens, lens, ideal_session().T_world_base["psm1"])
    pair = replace(day.station, cameras={"overhead": replace(day.station.cameras["overhead"], model=rig)})
    with pytest.raises(TrocarError, match="has no depth"):
        FiducialCell(replace(day, station=pair), "psm1", "overhead", SIX_SPHERES, np.random.default_rng(0))
