"""Values are displayed in notebooks in a line or a few, with units, and in tables that are safe HTML."""

import re
from functools import cache

import numpy as np
import pytest

from synthetic import synthetic_trial
from trocar.arms import MOTION_LIMITS, PSM_CLASSIC
from trocar.calibration.evaluation import Evaluation
from trocar.calibration.models import MODELS
from trocar.calibration.models.base import TrainingMotion
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording
from trocar.eval import Score
from trocar.geometry import SE3, fit_rigid
from trocar.lab import load_station
from trocar.motion import ArmMotion, HalfSpace, MotionProblem, MovingArm, plan_motion, plan_through
from trocar.notebook import SHOWN_ROWS, table
from trocar.report.summary import summarise
from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
from trocar.tasks.suture.planning.plan import PlannedSutures

LIMITS = MOTION_LIMITS["paper"]
MIDDLE = PSM_CLASSIC.middle
WAYPOINTS = [MIDDLE, MIDDLE + [0.1, 0.1, -0.01, 0.2, 0.0, 0.1]]
TABLE = HalfSpace([0.0, 0.0, -0.3], [0.0, 0.0, 1.0])
ASKED = MotionProblem(
    {"psm1": ArmMotion(PSM_CLASSIC, WAYPOINTS, LIMITS)}, obstacles={"table": TABLE}, min_distance_m=1e-3
)
NOWHERE = MotionProblem({"psm1": ArmMotion(PSM_CLASSIC, [MIDDLE], LIMITS, T_base_goals=SE3.identity((1,)))})


@cache
def recording():
    rng = np.random.default_rng(0)
    q = np.clip(np.cumsum(rng.normal(0, 0.05, (120, 6)), axis=0), -1, 1)
    return Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.arange(120) != 7, np.arange(120.0), "walk")


@cache
def station():
    return load_station("peg-transfer")


@cache
def trial():
    return synthetic_trial(failures={2: "DROPPED"})


@cache
def dexterities():
    return dexterity(PRESETS["default"].setup)


@cache
def sutures():
    return plan_even(dexterities(), 4)


def fitted(name):
    return MODELS[name].fit(recording(), np.random.default_rng(0))


VALUES = {
    "plan": (lambda: plan_through(PSM_CLASSIC, WAYPOINTS, LIMITS), r"psm-classic by 'spline': \d\.\d{3} s"),
    "no plan": (lambda: plan_motion(NOWHERE), "no MotionPlan: arm 'psm1', goal 0"),
    "problem": (lambda: ASKED, "psm1: <ArmMotion of psm-classic through 2 waypoints>; 1 mm from table"),
    "resting arm": (lambda: MovingArm.resting(PSM_CLASSIC, MIDDLE), r"MovingArm psm-classic from 0\.000 s"),
    "rigid fit": (lambda: fit_rigid(np.eye(3), np.eye(3)), r"3 of 3 points: rms \S+ mm, T_target_source <SE3"),
    "recording": (recording, r"'walk': 120 rows over 119\.0 s, 119 valid"),
    "evaluation": (
        lambda: Evaluation("offset", recording(), recording().q_cmd, 0.1),
        "'offset' on 119 rows of 'walk': RMSE .* deg",
    ),
    "training": (lambda: TrainingMotion.of(recording()), "119 rows: q4 q5 q6 from .* deg"),
    "offsets": (lambda: fitted("offset"), "'offset', fitted on 119 rows: .* deg"),
    "play": (lambda: fitted("play"), "'play', fitted on 119 rows: backlash .* deg"),
    "ridge": (lambda: fitted("ridge"), "'ridge', fitted on 119 rows>"),
    "station": (station, r"'peg-transfer': arms psm1 \(psm-classic\), .*cameras"),
    "arm of a station": (lambda: station().arm("psm1"), "psm-classic, transmission .* mm"),
    "camera": (lambda: next(iter(station().cameras.values())), "RGBD camera, at <SE3 .* mm"),
    "trial": (trial, r"session 0, trial 0 of seed .*: 11 of 12 transfers in .* s, 1 coll"),
    "scenery": (lambda: trial().scenery, "4 solids, arms psm1, psm2"),
    "replay": (lambda: trial().replay(), r"\d+\.\d s, 4 solids, 0 images"),
    "summary": (lambda: summarise([trial()]), r"11 of 12 transfers \(95 % interval .* %\), .* s each; 1 trials"),
    "score": (lambda: Score(True, False, "DROPPED", "it slipped", 1.0, 2.5), r"DROPPED, 1\.0 to 2\.5 s: it slipped"),
    "success": (lambda: Score(True, True, "", "", 1.0, 2.5), r"done, 1\.0 to 2\.5 s>"),
    "setup": (lambda: dexterities().setup, r"radius 30\.0 mm, needle of radius .* mm, psm-classic at <SE3"),
    "map": (dexterities, "360 positions: dexterity .* positions within the limits"),
    "sutures": (sutures, r"4 sutures: reward 0\.\d{4}, bound 0\.\d{4}, within the limits"),
    "planned sutures": (
        lambda: PlannedSutures(dexterities().setup, sutures().positions_rad, sutures().directions),
        "4, in order at .* deg",
    ),
}
TABLES = ("plan", "recording", "evaluation", "station", "trial", "summary", "sutures")


@pytest.mark.parametrize("name", VALUES)
def test_values_say_what_they_are_in_a_line_or_two(name):
    make, words = VALUES[name]
    text = repr(make())
    assert text.startswith("<") and text.endswith(">")
    assert len(text) <= 300 and text.count("\n") <= 1
    assert "array(" not in text
    assert re.search(words, text), text


def tags_of(page):
    return re.findall(r"<(\w+)", page)


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_html_whose_rows_are_as_long_as_their_head(name):
    make, _ = VALUES[name]
    tags = tags_of(make()._repr_html_())
    assert set(tags) <= {"div", "table", "thead", "tbody", "tr", "th", "td"}
    rows, columns = tags.count("tr") - 1, tags.count("th")
    assert columns >= 2 and tags.count("td") == rows * columns


def test_what_stands_in_a_table_is_escaped_and_a_long_one_is_cut():
    page = table("<script>", ["<b>"], [["<img src=x>"]] * (SHOWN_ROWS + 3))
    assert set(tags_of(page)) == {"div", "table", "thead", "tbody", "tr", "th", "td"}
    assert "and 3 more" in page and page.count("&lt;img") == SHOWN_ROWS


def test_a_failed_goal_is_named_in_the_table_of_a_trial():
    page = trial()._repr_html_()
    assert "<td>transfer 3</td><td>DROPPED</td>" in page and "<td>transfer 1</td><td>done</td>" in page
