"""What the options of the suture commands stand for, and what their tables say."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.commands.options import (
    files_line,
    in_si,
    pick,
    planner_of,
    points_table,
    recorded,
    spacing_of,
    table,
)
from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even


def test_parameters_are_given_in_millimetres_or_degrees():
    assert in_si("circle_radius_m", 30.0) == pytest.approx(0.030)
    assert in_si("base_tilt_rad", 180.0) == pytest.approx(np.pi)


@pytest.mark.parametrize(
    ("min_deg", "max_deg", "bounds_deg"),
    [(75.0, 105.0, (75, 105)), (75.0, None, (75, 360)), (None, 105.0, (1, 105))],
)
def test_a_bound_of_the_gaps_that_is_not_given_is_free(min_deg, max_deg, bounds_deg):
    spacing = spacing_of(4, 360, min_deg, max_deg)
    assert np.degrees([spacing.min_gap_rad, spacing.max_gap_rad]) == pytest.approx(bounds_deg)


def test_without_bounds_the_gaps_are_even_even_if_places_are_fixed_or_forbidden():
    assert spacing_of(4, 360, None, None) is None
    for given in ({"fix_deg": [90.0]}, {"forbid_deg": ["10:40"]}):
        spacing = spacing_of(5, 360, None, None, **given)
        assert np.degrees([spacing.min_gap_rad, spacing.max_gap_rad]) == pytest.approx((72, 72))
    spacing = spacing_of(5, 360, None, None, ["350:10.5"], [90.0, -5.0])
    assert np.degrees(spacing.forbidden_rad) % 360 == pytest.approx(np.array([[350, 10.5]]))
    assert np.degrees(spacing.fixed_rad) == pytest.approx([90, 355])


@pytest.mark.parametrize("text", ["10", "10:20:30", "ten:20", ""])
def test_an_arc_that_is_none_is_refused(text):
    with pytest.raises(TrocarError, match="FROM:TO"):
        spacing_of(4, 360, None, None, [text])


def test_the_planner_plans_as_many_sutures_as_were_asked_for_with_their_spacing():
    map = dexterity(PRESETS["default"].setup, positions=72)
    even = planner_of(3, None)(map)
    np.testing.assert_array_equal(even.positions_rad, plan_even(map, 3).positions_rad)
    gaps = np.degrees(planner_of(3, spacing_of(3, 72, 60.0, 130.0))(map).gaps_rad)
    assert len(gaps) == 3 and gaps.min() > 60 - 1e-6 and gaps.max() < 130 + 1e-6


def test_demonstrations_are_a_path_or_the_synthetic_ones(tmp_path):
    assert recorded(None) is None
    assert "synthetic" in recorded("synthetic").source
    with pytest.raises(TrocarError):
        recorded(str(tmp_path / "none.toml"))


def test_an_unknown_name_is_refused_with_the_choices():
    assert pick({"one": 1}, "one", "thing") == 1
    with pytest.raises(TrocarError, match="thing 'two' is unknown; choose one of one"):
        pick({"one": 1}, "two", "thing")


def rows_of(found):
    """Return the rows of a table."""
    return list(zip(*(column.cells for column in found.columns), strict=True))


def test_points_stand_beside_the_papers_with_what_they_are_above_them():
    found = points_table({"random": {"best": 80.6, "clockwise": 58.0}}, {"random": {"best": 88.64, "clockwise": 57.0}})
    assert rows_of(found) == [
        ("random", "best", "80.6", "88.6", "-8.0"),
        ("random", "clockwise", "58.0", "57.0", "+1.0"),
    ]


def test_numbers_stand_on_the_right_of_their_columns():
    found = table("title", ("word", "number"), [("a", "1.0")])
    assert [column.justify for column in found.columns] == ["left", "right"]


def test_files_are_named_if_any_were_written():
    assert files_line({"files": ["a.json", "b.png"]}) == ["files: a.json, b.png"]
    assert files_line({}) == []
