from dataclasses import replace
from math import radians

import matplotlib.image
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle as Disc
from matplotlib.patches import FancyArrowPatch, Wedge

from kept_figures import kept_figures
from trocar.geometry import SE3
from trocar.report import style
from trocar.tasks.suture.planning import PRESETS, Circle, Spacing, dexterity, plan_even, plan_gaps
from trocar.tasks.suture.planning.settings import with_settings
from trocar.tasks.suture.planning.study import study
from trocar.tasks.suture.planning.summary import plan_summary
from trocar.tasks.suture.report.circle import apart, draw_plan
from trocar.tasks.suture.report.panels import draw_reasons, draw_study

DEFAULT = PRESETS["default"]


def drawn(path):
    assert path.stat().st_size < 500_000
    return matplotlib.image.imread(path)[..., :3]


def share(image, color):
    """Return how much of the image has this colour."""
    return (np.abs(image - np.array(to_rgb(color))).max(-1) < 0.02).mean()


def test_the_circle_shows_in_red_what_is_out_of_reach(tmp_path):
    good = dexterity(DEFAULT.setup)
    wide = dexterity(replace(DEFAULT.setup, circle=Circle(0.090)))
    reached = drawn(draw_plan(good, plan_even(good), tmp_path / "new" / "good.png"))
    beyond = drawn(draw_plan(wide, plan_even(wide, 12), tmp_path / "beyond.png"))
    assert not plan_even(wide, 12).feasible
    assert share(beyond, style.VERMILION) > share(reached, style.VERMILION) > 0


@pytest.mark.parametrize(("count", "labelled"), [(1, 1), (4, 4), (12, 12), (24, 12), (90, 12)])
def test_labels_of_many_sutures_are_thinned_but_the_worst_ones_stays(count, labelled):
    plan = plan_even(dexterity(DEFAULT.setup), count)
    chosen = apart(plan)
    assert (len(chosen), len(set(chosen))) == (labelled, labelled)
    assert np.argmin(plan.rewards) in chosen
    places = np.sort(plan.positions_rad[chosen])
    gaps = np.diff(np.append(places, places[0] + 2 * np.pi))
    assert np.degrees(gaps.min()) > 25


def test_the_base_is_told_as_seen_from_the_circles_centre(tmp_path, monkeypatch):
    at = SE3.from_parts(translation_m=[0.020, -0.030, 0.010])
    found = dexterity(replace(DEFAULT.setup, circle=replace(DEFAULT.setup.circle, T_world_circle=at)))
    texts = []
    monkeypatch.setattr(Axes, "annotate", lambda axes, text, *_, **__: texts.append(text))
    draw_plan(found, plan_even(found), tmp_path / "plan.png")
    base = 50 * np.array([np.cos(np.radians(225)), np.sin(np.radians(225))]) - [20, -30]
    assert f"{np.hypot(*base):.0f} mm beside, 90 mm above the circle's centre" in " ".join(texts).replace("\n", " ")


@pytest.fixture
def figure(monkeypatch, tmp_path):
    """Return a function that draws something and returns its figure, which is not written."""
    figures = kept_figures(monkeypatch)

    def draw(by, *what):
        by(*what, tmp_path / "picture.png")
        return figures.pop()

    return draw


@pytest.mark.parametrize("azimuth_deg", range(-180, 180, 30))
def test_no_text_of_a_plan_leaves_the_picture_or_meets_the_colour_bar(figure, azimuth_deg):
    ports = {"base_azimuth_deg": azimuth_deg, "puller_up_mm": 100.0, "puller_azimuth_deg": azimuth_deg + 140.0}
    found = dexterity(with_settings(DEFAULT, ports).setup, positions=36)
    drawn = figure(draw_plan, found, plan_even(found))
    drawn.draw_without_rendering()
    axes, bar = drawn.axes
    boxes = [text.get_window_extent() for text in [*axes.texts, bar.yaxis.label, *drawn.texts, drawn._suptitle]]
    left = [box for box in boxes if box.p0.min() < 0.0 or (box.p1 > drawn.bbox.p1).any()]
    assert not left
    ports = [text.get_window_extent() for text in axes.texts if "port" in text.get_text() or "base" in text.get_text()]
    assert len(ports) == 2 and not any(box.overlaps(bar.get_window_extent()) for box in ports)


@pytest.mark.parametrize("margin", ["smallest", "paper"])
def test_no_label_of_the_reasons_leaves_the_picture(figure, margin):
    found = dexterity(DEFAULT.setup, replace(DEFAULT.reward, margin=margin), 36)
    drawn = figure(draw_reasons, found, plan_even(found))
    drawn.draw_without_rendering()
    assert all(axes.yaxis.label.get_window_extent().x0 > drawn.bbox.x0 for axes in drawn.axes)


def test_each_suture_is_labelled_where_it_is_with_its_angle_and_reward(figure):
    found = dexterity(DEFAULT.setup)
    plan = plan_even(found)
    drawn = figure(draw_plan, found, plan)
    places = {text.get_text(): text.get_position() for text in drawn.axes[0].texts}
    for theta, reward in zip(plan.positions_rad, plan.rewards, strict=True):
        x, y = places[f"{np.degrees(theta):.4g}°\n{reward:.3f}"]
        assert np.arctan2(y, x) % (2 * np.pi) == pytest.approx(theta) and np.hypot(x, y) < 30.0
    assert places["90°"][1] > 30.0 and places["180°"][0] < -30.0
    assert drawn.get_suptitle().strip() == f"4 sutures, reward of the worst {plan.reward:.3f}"
    beyond = replace(plan, feasible=False)
    assert figure(draw_plan, found, beyond).get_suptitle().strip().endswith(", out of reach")


def test_the_reasons_show_each_suture_at_its_angle_and_reward(figure):
    found = dexterity(DEFAULT.setup)
    plan = plan_even(found)
    top = figure(draw_reasons, found, plan).axes[0]
    dots = [np.ravel(line.get_data()) for line in top.get_lines() if line.get_marker() == "o"]
    np.testing.assert_allclose(dots, np.column_stack([np.degrees(plan.positions_rad), plan.rewards]))
    colours = [line.get_color() for line in top.get_lines() if line.get_marker() == "o"]
    assert colours == [style.BLUE if direction == 1 else style.ORANGE for direction in plan.directions]
    assert f"worst suture {plan.reward:.3f}" in [text.get_text() for text in top.texts]


def test_twelve_sutures_without_an_exit_are_drawn_too(tmp_path):
    setup = replace(DEFAULT.setup, insertion=replace(DEFAULT.setup.insertion, straight_m=0.05, theta_is="entry"))
    assert np.isnan(setup.bite_m)
    found = dexterity(setup)
    assert drawn(draw_plan(found, plan_even(found, 12), tmp_path / "plan.png")).std() > 0.05


def test_reasons_and_the_papers_figures_are_written_with_both_directions(tmp_path):
    found = dexterity(DEFAULT.setup)
    reasons = drawn(draw_reasons(found, plan_even(found), tmp_path / "reasons.png"))
    assert share(reasons, style.BLUE) > 0.001
    assert share(reasons, style.ORANGE) > 0.001
    demo = PRESETS["paper-demo"]
    files = draw_study(study(dexterity(demo.setup, demo.reward, 180), demo.fitted), tmp_path / "study")
    assert len(files) == 7
    bars = drawn(tmp_path / "study" / "figure_3.png")
    assert share(bars, style.BLUE) / share(bars, style.ORANGE) == pytest.approx(199 / 161, rel=0.1), "67 to 228 deg"


def test_what_was_fitted_is_said_below_the_papers_figures(monkeypatch, tmp_path):
    figures = kept_figures(monkeypatch)
    found = dexterity(PRESETS["paper-demo"].setup, PRESETS["paper-demo"].reward, 72)
    draw_study(study(found, PRESETS["paper-demo"].fitted), tmp_path)
    assert len(figures) == 7
    assert all("5 numbers of the setup" in drawn.get_supxlabel() for drawn in figures)
    draw_study(study(found), tmp_path)
    assert [drawn.get_supxlabel() for drawn in figures[7:]] == 7 * [""]


def patches(axes, kind):
    return [patch for patch in axes.patches if type(patch) is kind]


def test_the_mesh_is_drawn_to_its_edge_over_the_defect_and_holds_every_arrow(figure):
    circle = Circle(0.030, mesh_beyond_m=0.008, defect_within_m=0.010)
    found = dexterity(replace(DEFAULT.setup, circle=circle))
    axes = figure(draw_plan, found, plan_even(found)).axes[0]
    disc, radii = patches(axes, Disc), [patch.radius for patch in patches(axes, Disc)]
    assert {38.0, 30.0, 20.0} <= {round(radius, 6) for radius in radii}
    rings = [patch for patch in disc if patch.radius > 38.1]
    assert len(rings) == 4, "both rings lie outside of the mesh"
    for arrow in patches(axes, FancyArrowPatch):
        assert all(np.hypot(*end) < 38.0 for end in arrow._posA_posB)


def test_forbidden_arcs_and_fixed_positions_are_drawn(figure):
    found = dexterity(DEFAULT.setup)
    spacing = Spacing(radians(50), radians(100), ((radians(340), radians(20)),), (radians(90),))
    drawn = figure(draw_plan, found, plan_gaps(found, 5, spacing))
    axes = drawn.axes[0]
    arcs = [patch for patch in patches(axes, Wedge) if patch.get_facecolor()[:3] == to_rgb(style.VERMILION)]
    assert [(arc.theta1, arc.theta2) for arc in arcs] == [pytest.approx((340, 380))]
    fixed = [np.ravel(line.get_data()) for line in axes.lines if isinstance(line.get_marker(), tuple)]
    assert [np.degrees(np.arctan2(y, x)) for x, y in fixed] == pytest.approx([90])
    named = [text.get_text() for text in axes.get_legend().get_texts()]
    assert named == ["cannot be driven", "forbidden", "fixed position"]


def test_a_long_line_below_the_title_is_broken_not_cut(figure):
    found = dexterity(DEFAULT.setup)
    plan = replace(plan_even(found), certified="a long sentence " * 20)
    (line,) = [text for text in figure(draw_plan, found, plan).texts if "a long sentence" in text.get_text()]
    assert max(map(len, line.get_text().splitlines())) < 120


def test_the_room_of_the_joints_is_that_of_the_chosen_direction():
    found = dexterity(DEFAULT.setup)
    summary = plan_summary(found, plan_even(found))
    arm = found.setup.arm
    for theta, row, left in zip(
        summary["positions_deg"],
        [0 if d == 1 else 1 for d in summary["directions"]],
        summary["joint_room"],
        strict=True,
    ):
        q = found.joints.q[row, round(theta)]
        room = np.minimum(q - arm.lower, arm.upper - q).min(0)
        assert left["wrist_pitch_deg"] == pytest.approx(np.degrees(room[4]))
        assert left["insertion_mm"] == pytest.approx(1e3 * room[2])
