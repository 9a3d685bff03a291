"""What the script of one arm does when things go well, and when they do not."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import trio
from numpy.testing import assert_allclose

from simulated import T_WORLD_BASE, ideal_laboratory, standing
from trocar.arms import PSM_CLASSIC, fk
from trocar.errors import OutOfReach, TrocarError
from trocar.geometry import SE3
from trocar.robots import TICK_S
from trocar.robots.coordinator import Blocked
from trocar.tasks.peg_transfer.agents import Settings, quick
from trocar.tasks.peg_transfer.agents.motions import Motions
from trocar.tasks.peg_transfer.agents.peg_arm import LETS_GO_RAD, PegArm
from trocar.tasks.peg_transfer.agents.unilateral import Unilateral
from trocar.tasks.peg_transfer.agents.wall import WallOpening
from trocar.tasks.peg_transfer.goals import THERE, Transfer, TransferOutcome
from trocar.tasks.peg_transfer.perception import DepthView
from trocar.tasks.peg_transfer.shapes import Block, Pegboard
from two_armed import SETTINGS, Chooser, briefed, named, played, stuck

FIRST, SECOND = THERE[:2]
EMPTY = Transfer(10, 4)


class Blinkered(DepthView):
    """Sees the board and no block."""

    def find_block(self, image, T_camera_board, board, block, peg):
        return "these eyes see no block"


play = partial(played, "unilateral")


@pytest.fixture(scope="module")
def clean():
    return play([EMPTY, FIRST])


def test_a_transfer_ends_with_the_block_on_its_target(clean):
    lab, in_time, (_, score) = clean
    assert in_time
    assert score.attempted and score.succeeded
    assert named(lab, "transfer")[1]["outcome"] == TransferOutcome.DONE.name
    assert lab.record().collisions == ()


def test_jaws_open_beside_a_peg_no_further_than_lets_go_and_wide_only_over_the_pegs(clean):
    lab, _, (_, score) = clean
    rows, times_s = lab.recorder.arrays(), lab.truth().times_s
    jaw_rad, asked = rows["measured_psm1"][:, 6], rows["desired_psm1"]
    tip_m = (T_WORLD_BASE["psm1"] @ fk(PSM_CLASSIC, asked[:, :6].astype(float))).translation_m
    after = times_s > score.end_s - 0.2
    held, low = jaw_rad[after][0], after & (tip_m[:, 2] < Pegboard().peg_height_m)
    assert 0.1 < held < 0.25 and jaw_rad[low].max() == pytest.approx(held + LETS_GO_RAD, abs=0.02)


def test_jaws_that_have_loosened_their_grip_hold_until_they_are_told_to_open_and_then_open_sooner(clean):
    lab, in_time, (score,) = play([FIRST], settings=replace(SETTINGS, waits_for_jaws=False))
    assert in_time and score.succeeded
    released, before = ([span for span in played.log.spans if span.name == "jaw"][2] for played in (lab, clean[0]))
    sooner_s = (before.end_s - before.start_s) - (released.end_s - released.start_s)
    assert 0.09 < sooner_s < 0.13, "it does not have to come back from beyond the wall, and nobody waits until it rests"
    truth = lab.truth()
    lowered = (truth.times_s > released.start_s - 0.3) & (truth.times_s <= released.start_s)
    assert truth.held_by["psm1"][lowered, FIRST.source].all()


def test_a_wall_that_is_held_by_its_rim_is_let_go_and_taken_again():
    class Misled(DepthView):
        """Sees the block 1.1 mm off its place at first, so that a finger comes down on its wall."""

        looks = 0

        def find_block(self, image, T_camera_board, board, block, peg):
            found, self.looks = super().find_block(image, T_camera_board, board, block, peg), self.looks + 1
            return found if self.looks > 1 else SE3.from_parts(translation_m=[-1.1e-3, 0.0, 0.0]) @ found

    lab, in_time, (score,) = play(
        [FIRST], perception=Misled(), settings=replace(SETTINGS, jaw_empty_rad=quick().jaw_empty_rad)
    )
    assert in_time and score.succeeded
    (failed,) = named(lab, "pick failed")
    assert failed["jaw_rad"] > Settings().jaw_empty_rad, "the jaws held something"
    at = np.searchsorted(lab.truth().times_s, failed["time_s"])
    tip = T_WORLD_BASE["psm1"] @ fk(PSM_CLASSIC, lab.recorder.arrays()["true_psm1"][at, :6].astype(float))
    assert tip.translation_m[2] > Block().height_m - SETTINGS.depth_m / 2, "by its rim"


def test_an_empty_peg_is_said_so_and_the_script_goes_on(clean):
    lab, _, (empty, _) = clean
    assert (empty.available, empty.failure) == (False, TransferOutcome.NO_BLOCK.name)
    assert all("peg" in event and event["reason"] for event in named(lab, "no grasp"))


def test_every_part_is_noted_and_computing_takes_its_declared_time(clean):
    lab, _, (_, score) = clean
    spans = [span for span in lab.log.spans if score.start_s <= span.start_s and span.end_s <= score.end_s]
    assert {span.name for span in spans} == {"capture", "perception", "planning", "motion", "jaw", "settling"}
    assert {span.arm for span in spans} == {"psm1"}
    lasts = {span.name: span.end_s - span.start_s for span in spans}
    assert 0 <= lasts["perception"] - SETTINGS.perception_budget_s < TICK_S
    assert 0 <= lasts["planning"] - SETTINGS.planning_budget_s < TICK_S
    assert lasts["capture"] > 0.1
    assert all(computation.seconds > 0 for computation in lab.log.computations)


def test_a_person_chooses_among_the_transfers_whose_block_and_peg_are_there():
    person, back = Chooser(1, 0, 0), Transfer(*SECOND[::-1])
    lab, in_time, scores = play([FIRST, SECOND, back], person=person)
    assert in_time and all(score.succeeded for score in scores)
    assert [event["goal"] for event in named(lab, "transfer")] == [1, 0, 2]
    assert [[goal.words for goal in goals] for goals in person.offered] == [
        ["brings the block on peg 1 to peg 7", "brings the block on peg 0 to peg 6"],
        ["brings the block on peg 1 to peg 7", "brings the block on peg 6 to peg 0"],
        ["brings the block on peg 6 to peg 0"],
    ]
    feet_m = lab.cell.T_world_fixture["board"].apply(Pegboard().pegs_m[[1, 7]])
    assert_allclose(person.offered[0][0].path_world_m[[0, -1]], feet_m, atol=1e-3)
    assert {goal.arm for goals in person.offered for goal in goals} == {"psm1"}


def test_the_arm_leaves_the_board_at_the_end(clean):
    lab, _, _ = clean
    start = lab.session.station.arms["psm1"].park_q()
    assert np.abs(lab.cell.robot.setpoint("psm1").q - start).max() < 1e-6
    captured, seen = (max(s.end_s for s in lab.log.spans if s.name == name) for name in ("capture", "perception"))
    home = max(s.end_s for s in lab.log.spans if s.name == "motion")
    assert captured < home and seen > captured  # the last look is taken on the way


def test_a_robot_that_only_looks_at_rest_takes_longer_and_does_the_same(clean):
    _, _, (_, score) = clean
    lab, in_time, (_, slow) = play([EMPTY, FIRST], settings=replace(SETTINGS, looks_ahead=False))
    assert in_time and slow.succeeded
    assert slow.end_s > score.end_s + 0.1
    moving = [s for s in lab.log.spans if s.name == "motion"]
    for capture in (s for s in lab.log.spans if s.name == "capture"):
        assert all(capture.end_s <= m.start_s + 1e-9 or capture.start_s >= m.end_s - 1e-9 for m in moving)


def test_the_other_arm_stays_where_it_was(clean):
    lab, _, _ = clean
    assert np.ptp(lab.recorder.joints("commanded")["psm2"], axis=0)[:6].max() == 0.0


def test_what_is_sent_keeps_the_limits(clean):
    lab, _, _ = clean
    velocity, acceleration = lab.driver.limit_use("psm1")
    assert 0.9 < acceleration <= 1.0 + 1e-3 and velocity <= 1.0 + 1e-3
    assert named(lab, "guard") == []


def test_a_last_look_says_which_blocks_lie_where_they_were_set_down(clean):
    lab, _, (_, score) = clean
    (check,) = named(lab, "check")
    assert score.target in check["pegs"] and not check["missing"]
    assert score.target in lab.truth().pegs[-1]


def test_what_the_last_look_showed_is_noted_for_whoever_watches_where_it_is(clean):
    lab, _, (_, score) = clean
    ((name, camera),) = lab.cameras.items()
    seen = lab.log.sightings[name]
    assert seen.image is camera.taken[-1]
    rim_m = lab.session.T_world_camera[name].apply(seen.outlines_m[f"block on {score.target}"])
    block = list(lab.truth().pegs[-1]).index(score.target)
    true_m = lab.recorder.arrays()[f"body_block{block}"][-1, :3]
    assert np.linalg.norm(rim_m.mean(0) - true_m) < 1e-3


def test_a_pick_that_fails_is_tried_again_with_another_grasp_and_then_given_up():
    lab, _, (score,) = play([FIRST], robot=stuck("psm1"))
    assert len(named(lab, "pick failed")) == 1 + SETTINGS.retries
    assert named(lab, "transfer")[0]["outcome"] == TransferOutcome.NOT_GRASPED.name
    assert score.attempted and score.failure == "NOT_GRASPED"
    tip_m = lab.truth().p_board_tips["psm1"]
    low = tip_m[tip_m[:, 2] < 0.013]
    assert np.ptp(low, axis=0)[:2].max() > 1e-3


@pytest.mark.parametrize("off_mm", [(1.6, 1.6, 0.0), (-2.2, 0.0, 0.0)])
def test_jaws_that_missed_a_block_are_looked_at_and_then_find_it(off_mm):
    """The base is registered aside of where it stands."""
    settings = replace(SETTINGS, learns_offset=True)
    lab, in_time, scores = play([FIRST, SECOND], settings=settings, registered_off_m={"psm1": 1e-3 * np.array(off_mm)})
    assert in_time and all(score.succeeded for score in scores), scores
    assert len(named(lab, "pick failed")) == 1
    (learned,) = named(lab, "offset")
    # the tip is the other way; one look counts as much as the expectation that it is off by half a millimetre at most
    assert_allclose(learned["mm"], -0.55 * np.array(off_mm[:2]), atol=0.25)


def test_it_sees_with_the_perception_that_it_is_given():
    lab, in_time, (score,) = play([FIRST], perception=Blinkered())
    assert in_time and (score.succeeded, score.failure) == (False, "NO_BLOCK")
    assert {event["reason"] for event in named(lab, "no grasp")} == {"these eyes see no block"}


def test_a_spent_budget_ends_the_script_where_it_is():
    lab, in_time, scores = play([FIRST, SECOND], budget_s=4.0)
    assert not in_time
    assert 4.0 < lab.now_s() < 4.6
    assert [score.succeeded for score in scores] == [False, False]
    assert named(lab, "transfer") == []


def test_an_arm_that_is_not_there_is_named():
    with pytest.raises(TrocarError, match=r"'psm3'.*psm1, psm2"):
        play([FIRST], arms=("psm3",))


def test_a_cell_without_a_depth_camera_is_refused():
    lab = ideal_laboratory(standing(0))
    lab.cell = replace(lab.cell, cameras={})
    with pytest.raises(TrocarError, match=r"needs an RGBD camera.*add one to the station"):
        Unilateral(briefed(lab))


@pytest.mark.parametrize(("looks", "near_m"), [(True, (0.0, 0.5e-3)), (False, (0.8e-3, 2e-3))])
def test_a_block_that_hangs_otherwise_than_believed_is_placed_well_if_it_is_looked_at(looks, near_m, monkeypatch):
    """It is believed 1.2 mm away along its wall; told by truth where it comes to lie, against where one that was."""

    def believed(motions, q, T_board_block, told=Motions.gripped):
        return SE3.from_parts(translation_m=[0.0, 1.2e-3, 0.0]) @ told(motions, q, T_board_block)

    settings = replace(SETTINGS, looks_before_placing=looks)
    lain = []
    for wrong in (False, True):
        if wrong:
            monkeypatch.setattr(Motions, "gripped", believed)
        lab, _, scores = play([FIRST], blocks=[standing(FIRST.source)], settings=settings)
        assert scores[0].succeeded
        lain.append(lab.truth().T_board_blocks.matrix[-1, 0, :2, 3])
    assert near_m[0] < np.linalg.norm(lain[1] - lain[0]) < near_m[1]


def test_a_block_that_cannot_be_lowered_as_it_was_seen_is_lowered_as_it_was_planned(monkeypatch):
    def out_of_reach(motions, q, T_tip_block, target):
        raise OutOfReach("wrist_yaw would be at 90 deg; go elsewhere")

    monkeypatch.setattr(Motions, "lowering", out_of_reach)
    _, _, (score,) = play(
        [FIRST], blocks=[standing(FIRST.source)], settings=replace(SETTINGS, looks_before_placing=True)
    )
    assert score.succeeded


class Jaws:
    """Jaws of an arm without a cell, that stop somewhere when they close."""

    def __init__(self, stop_rad, hands_over=False):
        self.settings, self.hands_over, self.after_release = SETTINGS, hands_over, None
        self.hand = self
        self.table = SimpleNamespace(wall=WallOpening(SETTINGS))
        self.motions = SimpleNamespace(held=lambda T_tip_block: "a block")
        self.coordinator = SimpleNamespace(carry=lambda arm, what: carried.append(what))
        self.name, self.stop_rad, self.jaw_rad, self.asked = "psm1", stop_rad, 0.4, []
        carried = self.carried = []

    holds = PegArm.holds

    async def close_on(self, angle_rad):
        self.asked.append(angle_rad)
        self.jaw_rad = max(angle_rad, self.stop_rad)
        return self.jaw_rad

    part = close_on


@pytest.mark.parametrize(
    ("jaw_rad", "held"), [(0.0, False), (0.12, False), (0.17, True), (0.302, True), (SETTINGS.release_rad, False)]
)
def test_jaws_have_gripped_what_is_as_thick_as_a_wall(jaw_rad, held):
    """The thickest wall of a served cell was read as .302; jaws that stay open were blocked by something else."""
    arm = Jaws(jaw_rad)
    assert trio.run(PegArm.grip, arm, None) is held
    assert arm.carried == ["a block" if held else None]


@pytest.mark.parametrize(
    ("hands_over", "held_rad", "open_rad"),
    [(False, 0.1, SETTINGS.release_rad), (False, 0.3, SETTINGS.jaw_open_rad), (True, 0.3, 0.44), (True, 0.33, 0.46)],
)
def test_thick_walls_that_were_taken_from_the_other_arm_are_released_as_thin_ones_are(hands_over, held_rad, open_rad):
    arm = Jaws(held_rad, hands_over)
    arm.jaw_rad = held_rad
    trio.run(PegArm.open, arm)
    assert arm.asked == [pytest.approx(open_rad)] and arm.carried == [None]


def test_an_arm_that_is_blocked_over_its_target_keeps_its_block_and_tries_again(monkeypatch):
    blocked = []

    async def lower(arm, *how, told=PegArm._lower):
        if len(blocked) < 1:
            blocked.append(arm.holds)
            raise Blocked("psm1")
        return await told(arm, *how)

    monkeypatch.setattr(PegArm, "_lower", lower)
    lab, _, (score,) = play(
        [FIRST], blocks=[standing(FIRST.source)], settings=replace(SETTINGS, looks_before_placing=True)
    )
    assert blocked == [True] and score.succeeded
    assert [event["outcome"] for event in named(lab, "transfer")] == [TransferOutcome.DONE.name]
