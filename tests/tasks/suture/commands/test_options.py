"""What the options of the suture commands stand for, and what their tables say."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.commands.options import (
    chosen_preset,
    files_line,
    fitted_line,
    planner_of,
    points_table,
    recorded,
    spacing_of,
)
from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
from trocar.tasks.suture.planning.primitive import least_gap_rad

SETUP = PRESETS["default"].setup


def spacing(count, search=None, gap=None, *rest):
    return spacing_of(count, search, gap, *rest, setup=SETUP)


def bounds_deg(found):
    return np.degrees([found.min_gap_rad, found.max_gap_rad])


@pytest.mark.parametrize(
    ("gap", "bounds"), [("75:105", (75, 105)), ("75:", (75, 120)), (":105", (60, 105)), (":", (60, 120))]
)
def test_a_bound_of_the_gaps_that_is_not_given_is_a_third_from_even(gap, bounds):
    assert bounds_deg(spacing(4, None, gap)) == pytest.approx(bounds)
    assert bounds_deg(spacing(4, "gaps", gap)) == pytest.approx(bounds)


def test_without_a_bound_gaps_are_such_that_bites_do_not_cross_if_that_is_possible():
    least = np.degrees(least_gap_rad(SETUP))
    assert 30 < least < 45
    assert bounds_deg(spacing(4, "gaps")) == pytest.approx((60, 120))
    assert bounds_deg(spacing(8, "gaps")) == pytest.approx((least, 60))
    assert bounds_deg(spacing(12, "gaps")) == pytest.approx((30, 40)), "nothing but even gaps is as wide"
    assert bounds_deg(spacing(1, "gaps")) == pytest.approx((240, 360))
    assert bounds_deg(spacing(8, "gaps", "20:60")) == pytest.approx((20, 60)), "as asked"
    assert bounds_deg(spacing(4, "gaps", ":30")) == pytest.approx((30, 30)), "which the planner refuses with its reason"
    assert bounds_deg(spacing(4, "gaps", "200:")) == pytest.approx((200, 200))


def test_gaps_are_even_even_if_places_are_fixed_or_forbidden():
    assert spacing(4) is None and spacing(4, "even") is None
    for given in (([], [90.0]), (["10:40"], [])):
        assert bounds_deg(spacing(5, "even", None, *given)) == pytest.approx((72, 72))
    found = spacing(5, None, None, ["350:10.5"], [90.0, -5.0])
    assert np.degrees(found.forbidden_rad) % 360 == pytest.approx(np.array([[350, 10.5]]))
    assert np.degrees(found.fixed_rad) == pytest.approx([90, 355])


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ((4, "even", "60:"), "gaps of 60: deg are no even ones; drop --gap, or give --search gaps"),
        ((4, "free"), "the search 'free' is unknown; choose one of even, gaps"),
        ((4, None, "60"), "the gap is '60'; give .* LOW:HIGH"),
        ((4, None, "60:a"), "the gap is '60:a'"),
        ((4, None, "1:2:3"), "the gap is '1:2:3'"),
        ((4, None, "120:60"), "120 deg and 60 deg"),
        ((4, None, "nan:"), "bounded by nan deg"),
        *(((4, None, None, [text]), "FROM:TO") for text in ("10", "10:20:30", "ten:20", "")),
    ],
)
def test_a_spacing_that_is_none_is_refused(asked, words):
    with pytest.raises(TrocarError, match=words):
        spacing(*asked)


def test_a_preset_is_taken_by_name_or_file_with_settings_and_arm(tmp_path):
    found = chosen_preset("default", ["circle_radius_mm=28", "pushes=1", "circle_radius_mm=29"], "psm-si")
    assert found.setup.circle.radius_m == pytest.approx(0.029), "the last one counts"
    assert (found.setup.insertion.pushes, found.setup.arm.name) == (1, "psm-si")
    (tmp_path / "mine.toml").write_text("[set]\nbase_up_mm = 90\n")
    assert chosen_preset(str(tmp_path / "mine.toml"), None).setup.T_world_base.translation_m[2] == pytest.approx(0.09)


def test_the_planner_plans_as_many_sutures_as_were_asked_for_with_their_spacing():
    map = dexterity(PRESETS["default"].setup, positions=72)
    even = planner_of(3, None)(map)
    np.testing.assert_array_equal(even.positions_rad, plan_even(map, 3).positions_rad)
    gaps = np.degrees(planner_of(3, spacing(3, None, "60:130"))(map).gaps_rad)
    assert len(gaps) == 3 and gaps.min() > 60 - 1e-6 and gaps.max() < 130 + 1e-6


def test_demonstrations_are_a_path_or_the_synthetic_ones(tmp_path):
    assert recorded(None) is None
    assert "synthetic" in recorded("synthetic").source
    with pytest.raises(TrocarError):
        recorded(str(tmp_path / "none.toml"))


def rows_of(found):
    """Return the rows of a table."""
    return list(zip(*(column.cells for column in found.columns), strict=True))


def test_points_stand_beside_the_papers_with_what_they_are_above_them():
    found = points_table({"random": {"best": 80.6, "clockwise": 58.0}}, {"random": {"best": 88.64, "clockwise": 57.0}})
    assert rows_of(found) == [
        ("random", "best", "80.6", "88.6", "-8.0"),
        ("random", "clockwise", "58.0", "57.0", "+1.0"),
    ]


def test_files_are_named_if_any_were_written():
    assert files_line({"files": ["a.json", "b.png"]}) == ["files: a.json, b.png"]
    assert files_line({}) == []


def test_what_was_fitted_is_said_if_anything_was():
    (line,) = fitted_line(PRESETS["paper-demo"].fitted)
    assert line.startswith("fitted: 5 numbers of the setup (base tilt, ")
    assert fitted_line(()) == []
