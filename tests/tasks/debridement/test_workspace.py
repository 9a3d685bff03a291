"""What is known about the work surface."""

import numpy as np

from trocar.tasks.debridement.workspace import Receptacle, Workspace


def test_the_receptacle_is_that_of_the_paper():
    assert Receptacle().size_m == (0.110, 0.070)


def test_what_lies_between_the_walls_is_in_the_receptacle():
    box = Receptacle()
    x, y = 0.5 * np.array(box.size_m)
    inside = [[0, 0, 0.004], [x - 1e-4, y - 1e-4, 0.004], [0, 0, box.height_m - 1e-4]]
    outside = [[x + 1e-4, 0, 0.004], [0, -y - 1e-4, 0.004], [0, 0, box.height_m + 1e-4]]
    assert box.holds(np.array(inside)).all()
    assert not box.holds(np.array(outside)).any()


def test_fragments_lie_beside_the_receptacle_of_the_built_in_station():
    low, high = np.array(Workspace().region_m)
    assert (high - low > 0.04).all()
    edge = 0.012 - 0.5 * Receptacle().size_m[1] - Receptacle().wall_m  # the fixture's y
    assert high[1] + 0.5 * Workspace().fragment_m[1] < edge
