"""How hard a laboratory is, and how that is described."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import fk
from trocar.calibration.excitation import MotionBox
from trocar.calibration.plant import PSM1_GREY, PSM1_GREY_SESSIONS, PSM2_GREY
from trocar.errors import InvalidInput, TrocarError
from trocar.eval import TASKS
from trocar.geometry import SE3
from trocar.geometry.rigid_fit import fit_rigid
from trocar.lab import Registration, load_station
from trocar.lab.flaws import FLAWS, LEVELS, Difficulty
from trocar.lab.session import draw_session, points_of_registration
from trocar.lab.transmission import JawCable
from trocar.sim.calibration_cells import record_motion

STATION = load_station("peg-transfer")


@pytest.mark.parametrize("flaw", FLAWS)
def test_every_flaw_grows_from_mild_to_harsh_and_says_where_it_comes_from(flaw):
    sizes = [FLAWS[flaw].size(Difficulty.of(level)[flaw]) for level in LEVELS]
    assert sizes[0] <= sizes[1] < sizes[2] == pytest.approx(2 * sizes[1])
    assert FLAWS[flaw].source


@pytest.mark.parametrize("flaw", FLAWS)
def test_every_flaw_can_be_switched_off_by_itself(flaw):
    without = Difficulty.of("recorded", [f"{flaw}=0"])
    assert not without[flaw].any() and without.scale(flaw) == 0.0
    for other in FLAWS.keys() - {flaw}:
        assert np.array_equal(without[other], Difficulty.of("recorded")[other])


def test_the_documentation_has_every_flaw_with_its_sizes():
    table = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
    mild, recorded = (Difficulty.of(level) for level in ("mild", "recorded"))
    for name, flaw in FLAWS.items():
        assert f"| `{name}` | {flaw.about} | {mild.shown(name)} | {recorded.shown(name)} | {flaw.source} |" in table


def test_a_size_is_a_root_mean_square_in_its_unit_or_times_what_was_recorded():
    given = Difficulty.of("mild", ["offsets=3deg", "wear=2", "registration=1.0mm", "outer=.0003 m"])
    assert np.sqrt(np.mean(given["offsets"] ** 2)) == pytest.approx(np.radians(3.0))
    assert given["wear"] == pytest.approx(2 * np.array(FLAWS["wear"].recorded))
    assert given["registration"] == pytest.approx([1e-3])
    assert given.scale("wear") == pytest.approx(2.0)
    shown = {"offsets": "3 deg", "wear": "2 x", "registration": "1 mm", "outer": "0.3 mm"}
    assert {name: given.shown(name) for name in shown} == shown


RELEVANT = {
    "peg-transfer": {"print", "registration", "depth"},
    "suture": {"needle", "registration", "cameras", "depth"},
    "debridement": set(),
}


@pytest.mark.parametrize("task", RELEVANT)
def test_every_flaw_that_is_felt_is_told_and_no_other_may_be_given(task):
    """Each one that a task owns is its own alone; points register a second camera against the first."""
    station = load_station(TASKS[task].station)
    relevant = set(station.relevant_flaws(task))
    of_stations = {"registration", "cameras", "depth", "print", "needle"}
    assert relevant & of_stations == RELEVANT[task] and {"jaw", "tool"} <= relevant
    told = {text.partition(":")[0] for text in station.flaws(task)}
    assert relevant == told & FLAWS.keys()
    for flaw in FLAWS:
        named = replace(station, difficulty=Difficulty.of("mild", [f"{flaw}=0"]))
        if flaw in relevant:
            assert named.require_relevant(task) is named
        else:
            with pytest.raises(InvalidInput, match=f"{flaw}.*has no effect on '{task}' at station"):
                named.require_relevant(task)


def test_what_the_file_has_registered_no_session_registers_again():
    station = load_station("suture")
    arms = {name: replace(arm, T_world_base_registered=arm.T_world_base) for name, arm in station.arms.items()}
    cameras = {name: replace(c, T_world_camera_registered=c.T_world_camera) for name, c in station.cameras.items()}
    assert "registration" not in replace(station, arms=arms).relevant_flaws()
    assert "cameras" not in replace(station, cameras=cameras).relevant_flaws()
    assert "psm1" in next(
        text for text in replace(station, arms=arms).flaws() if text.startswith("registration of psm")
    )


@pytest.mark.parametrize(
    ("level", "flaws", "what"),
    [
        ("easy", [], "easy"),
        ("mild", ["offset=3deg"], "'offset' is unknown"),
        ("mild", ["offsets=3mm"], "offsets=3mm"),
        ("mild", ["offsets"], "offsets=2deg"),
        ("mild", ["wear=2mm"], "how many times"),
        ("mild", ["creep=-1deg"], "creep=-1deg"),
        ("mild", ["creep=nan"], "creep=nan"),
        ("mild", ["registration=1e999mm"], "registration"),
        ("mild", ["jaw=1e300deg"], "more than 100 times what was recorded; give 172 deg or less"),
        ("mild", ["wear=101"], "give 100 x or less"),
        ("mild", ["jaw=1deg", "wear=1", "jaw=0"], "'jaw' is given twice"),
    ],
)
def test_what_cannot_be_read_is_said(level, flaws, what):
    with pytest.raises(TrocarError, match=what):
        Difficulty.of(level, flaws)


def day(difficulty, rng):
    return draw_session(replace(STATION, difficulty=difficulty), rng)


def off_mm(session, p_world=(0.0, 0.0, 0.02)):
    T = session.T_world_base_registered["psm1"] @ session.T_world_base["psm1"].inverse()
    return 1e3 * float(np.linalg.norm(T.apply(np.array(p_world)) - p_world))


def test_a_base_is_registered_as_badly_as_it_is_asked_for():
    far = [off_mm(day(Difficulty.of("mild", ["registration=1mm"]), np.random.default_rng(k))) for k in range(40)]
    near = [off_mm(day(Difficulty.of("mild"), np.random.default_rng(k))) for k in range(40)]
    assert np.sqrt(np.mean(np.square(far))) == pytest.approx(np.sqrt(3.0), rel=0.25)
    assert np.mean(near) < 0.1


def test_errors_of_the_outer_joints_are_in_the_registration_and_neighbours_err_alike():
    outer = Difficulty.of("mild", ["outer=0.26mm"])
    arm, how = STATION.arm("psm1"), STATION.registration
    assert isinstance(how, Registration)
    left_mm, alike = [], []
    for k in range(6):
        rng = np.random.default_rng(k)
        p_base, seen = points_of_registration(arm, arm.transmission.drawn(rng, outer), how, outer, rng)
        rest = seen - fit_rigid(p_base, seen).T_target_source.apply(p_base)
        apart = np.linalg.norm(seen[:, None] - seen[None], axis=2) + np.diag(np.full(len(seen), np.inf))
        left_mm.append(1e3 * np.sqrt(np.mean(np.sum(rest**2, axis=1))))
        alike.append(np.sum(rest * rest[apart.argmin(axis=1)]) / np.sum(rest**2))
    assert 0.3 < np.mean(left_mm) < 0.8  # .33 to .63 mm in the recorded sets
    assert np.mean(alike) > 0.4  # .72 to .89


def test_a_flaw_leaves_the_draws_of_others_alone():
    one = day(Difficulty.of("mild"), np.random.default_rng(0))
    other = day(Difficulty.of("mild", ["wear=1", "residual=1deg", "jaw=1deg", "tool=1mm"]), np.random.default_rng(0))
    middles = {"psm1": (PSM1_GREY.offset, PSM1_GREY_SESSIONS.offset), "psm2": (PSM2_GREY.offset, PSM2_GREY.offset)}
    for arm in STATION.arms:
        drawn = [
            session.transmissions[arm].plant.offset - middle
            for session, middle in zip((one, other), middles[arm], strict=True)
        ]
        assert_allclose(*drawn, atol=1e-12)
        assert np.array_equal(one.T_world_base_registered[arm].matrix, other.T_world_base_registered[arm].matrix)
    lengths = [drawn.models[arm].wrist_length_m for drawn in (one, other) for arm in STATION.arms]
    assert lengths[0] == lengths[1] == STATION.arm("psm1").model.wrist_length_m and len(set(lengths)) == 3
    assert one.jaws["psm1"] == JawCable() and other.jaws["psm1"].offset_rad != other.jaws["psm2"].offset_rad


def test_depth_scatters_as_much_more():
    drawn = day(Difficulty.of("mild", ["depth=3"]), np.random.default_rng(0))
    usual = STATION.cameras["overhead"].flaws
    scale = 3 * FLAWS["depth"].recorded[0]
    assert drawn.station.cameras["overhead"].flaws.axial_m == pytest.approx(scale * usual.axial_m)


def test_jaws_follow_with_play_beside_their_place():
    cable, followed, pulled = JawCable(offset_rad=0.1, play_rad=0.05), 0.0, []
    for jaw in (0.0, 0.04, 0.5, 0.47, 0.3):
        at, followed = cable.step(followed, jaw)
        pulled.append(at)
    assert pulled == pytest.approx([0.1, 0.1, 0.55, 0.55, 0.45])


def test_the_motor_of_the_jaws_shows_what_stops_the_fingers_but_not_what_they_lack_of_their_opening():
    cable, followed, read = JawCable(offset_rad=0.1, play_rad=0.05), 0.0, []
    for commanded, stop in ((-0.2, 0.0), (0.4, None), (-0.2, 0.25), (0.1, 0.25), (0.22, 0.25), (0.4, None)):
        pulled, followed = cable.step(followed, commanded)
        fingers = pulled if stop is None else max(pulled, stop + 0.1)
        read.append(cable.read(fingers, commanded))
    assert read == pytest.approx([-0.05, 0.4, 0.2, 0.2, 0.22, 0.4])
    closed, opened, wall = read[:3]
    assert wall - closed == pytest.approx(0.25), "closings differ as the fingers do"
    fingers = cable.step(0.0, opened)[0] - 0.1
    assert opened - closed == pytest.approx(fingers + 2 * 0.05), "they seem wider than they are by the whole play"


def test_what_fiducials_show_is_in_the_base_that_was_registered():
    """A base that is found beside its place makes joints seem to be elsewhere, as in a laboratory."""
    drawn = day(Difficulty.of("mild", ["registration=3mm", "noise=0"]), np.random.default_rng(1))
    box = STATION.arm("psm1").calibration
    assert isinstance(box, MotionBox)
    rows = record_motion(drawn, "psm1", np.random.default_rng(2), box, 40)
    seen = fk(STATION.arm("psm1").model, rows.q_phy[rows.valid])
    told = fk(STATION.arm("psm1").model, rows.q_cmd[rows.valid])
    T_found_true = drawn.T_world_base_registered["psm1"].inverse() @ drawn.T_world_base["psm1"]
    shift = T_found_true.apply(told.translation_m) - told.translation_m
    assert isinstance(seen, SE3)
    outer = np.abs(rows.q_phy - rows.q_cmd)[rows.valid][:, :3].max(axis=0)
    assert np.linalg.norm(shift, axis=1).mean() > 2e-3
    assert outer.max() > 3e-3
