"""Settings in words and setup files describe the same presets."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS
from trocar.errors import BadFile, TrocarError
from trocar.tasks.suture.needle import NEEDLES
from trocar.tasks.suture.planning import MARGINS, PRESETS, Preset, Reward
from trocar.tasks.suture.planning.parameters import SEARCHED, with_parameters
from trocar.tasks.suture.planning.settings import preset_of, setting_of, settings_between, setup_file, with_settings

DEFAULT, DEMO = PRESETS["default"], PRESETS["paper-demo"]


def same(one, other):
    """Whether two setups are the same up to rounding of what is written."""
    np.testing.assert_allclose(one.T_base_circle.matrix, other.T_base_circle.matrix, atol=1e-7)
    np.testing.assert_allclose(one.grasp.rotation.matrix, other.grasp.rotation.matrix, atol=1e-7)
    for part in ("needle", "circle", "grasp", "insertion"):
        for name, value in vars(getattr(other, part)).items():
            if isinstance(value, float):
                assert getattr(getattr(one, part), name) == pytest.approx(value, abs=1e-7), name
    assert (one.arm, one.insertion.theta_is, one.insertion.pushes) == (
        other.arm,
        other.insertion.theta_is,
        other.insertion.pushes,
    )


def test_values_may_be_texts_in_mm_and_deg():
    given = {"circle_radius_mm": "28", "base_tilt_deg": 30, "center_z_mm": 2.5, "regrasp_deg": "30", "pushes": "1"}
    setup = with_settings(DEFAULT, given, "psm-si").setup
    assert setup.circle.radius_m == pytest.approx(0.028)
    assert setup.insertion.regrasp_rad == pytest.approx(np.radians(30)) and setup.insertion.pushes == 1
    assert setup.circle.T_world_circle.translation_m == pytest.approx([0, 0, 0.0025])
    assert setup.arm is ARMS["psm-si"]
    assert with_settings(DEFAULT, {}).setup == DEFAULT.setup


def test_a_needle_of_the_catalogue_may_be_changed_further_and_fits_the_grasp_of_the_same_line():
    grasp = {"pushes": 1, "grasp_behind_tip_deg": 130}
    setup = with_settings(DEFAULT, {"needle": "SH", **grasp}).setup
    assert setup.needle == NEEDLES["SH"]
    other = with_settings(DEFAULT, {"needle": "SH", "needle_radius_mm": 8, **grasp}).setup
    assert (other.needle.radius_m, other.needle.arc_rad) == (pytest.approx(0.008), NEEDLES["SH"].arc_rad)
    with pytest.raises(TrocarError, match=r"last grasp lies 205 deg behind .* tail at 180 deg"):
        with_settings(DEFAULT, {"needle": "SH"})


def test_what_is_set_was_not_fitted():
    assert "base_tilt_deg" in DEMO.fitted
    assert with_settings(DEMO, {}).fitted == DEMO.fitted
    changed = with_settings(DEMO, {"base_tilt_deg": 20, "circle_radius_mm": 31})
    assert set(DEMO.fitted) - set(changed.fitted) == {"base_tilt_deg"}


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_setup_file_describes_any_preset_of_such_numbers(seed, tmp_path_factory):
    rng = np.random.default_rng(seed)
    values = {name: rng.uniform(*bounds) for name, bounds in SEARCHED.items()}
    setup = with_parameters(DEFAULT.setup, values, arm=list(ARMS.values())[rng.integers(len(ARMS))])
    setup = replace(setup, insertion=replace(setup.insertion, pushes=1, theta_is=("entry", "middle")[seed % 2]))
    reward = Reward(
        list(MARGINS)[rng.integers(len(MARGINS))],
        weight=float(rng.random()),
        at="stations",
        feasible_first=bool(seed % 2),
        joint_weights=(1.0, float(rng.random()), 0.0),
        caution=0.5,
    )
    path = tmp_path_factory.mktemp("setup") / "setup.toml"
    path.write_text(setup_file(Preset(setup, reward)))
    again = preset_of(str(path))
    same(again.setup, setup)
    assert again.reward == reward
    assert settings_between(setup, setup) == {}


def written(tmp_path, text):
    (tmp_path / "setup.toml").write_text(text)
    return preset_of(str(tmp_path / "setup.toml"))


def test_a_file_says_what_differs_from_a_preset(tmp_path):
    text = 'preset = "paper-demo"\n[set]\nbase_up_mm = 90\n[reward]\nweight = 1\njoint_weights = [1, 2.0, 0]\n'
    found = written(tmp_path, text)
    same(found.setup, with_settings(DEMO, {"base_up_mm": 90}).setup)
    assert found.reward == replace(DEMO.reward, weight=1, joint_weights=(1, 2, 0))
    assert written(tmp_path, "").setup == DEFAULT.setup


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base_tilt_deg = 3", "the key 'base_tilt_deg' is unknown; choose one of preset, arm, set, reward"),
        ('preset = "demo"', "the preset 'demo' is unknown; choose one of default, paper-demo"),
        ("preset = 3", "the preset 3 is unknown"),
        ('arm = "psm"', "the arm 'psm' is unknown.*psm-classic"),
        ("set = 3", "set is 3; give a table"),
        ("[set]\ntilt = 3", "the setting 'tilt' is unknown; choose one of center_x_mm"),
        ('[set]\nbase_tilt_deg = "much"', "the setting base_tilt_deg is 'much'; give a number in deg"),
        ("[set]\nbase_up_mm = nan", "the setting base_up_mm is nan; give a number in mm"),
        ("[set]\nbase_up_mm = true", "the setting base_up_mm is True"),
        ("[set]\npushes = 1.5", "the setting pushes is '?1.5'?; give a whole number"),
        ("[set]\npushes = 11", "number of pushes is 11; give 0 to 10"),
        ("[set]\ntheta_is = 3", "point of a suture at theta '?3'? is unknown"),
        ("[set]\nneedle = 3", "the needle '3' is unknown; choose one of RB-1"),
        ("[set]\ncircle_radius_mm = 3", "a needle of radius 8.3 mm is too large"),
        ("[reward]\nlambda = 3", "the reward's 'lambda' is unknown"),
        ('[reward]\nweight = "3"', "the reward's weight is '3'; give a number"),
        ("[reward]\nweight = 3", "lambda is 3; give 0 to 1"),
        ("[reward]\nfeasible_first = 1", "the reward's feasible_first is 1; give true or false"),
        ("[reward]\njoint_weights = [1, 2]", "the joints' weights is 1, 2; give three"),
        ('[reward]\njoint_weights = ["1", 2, 3]', "joint_weights is .*; give three numbers"),
        ("[reward]\nmargin = 3", "the reward's margin is 3; give a word"),
        ("[set", "is not TOML"),
    ],
)
def test_a_file_that_describes_no_setup_is_refused_in_a_sentence(tmp_path, text, words):
    with pytest.raises(BadFile, match=words) as caught:
        written(tmp_path, text)
    assert str(tmp_path / "setup.toml") in str(caught.value) and "\n" not in str(caught.value)


def test_a_name_that_is_none_and_a_file_that_is_missing_are_refused(tmp_path):
    with pytest.raises(TrocarError, match=r"preset 'magic' is unknown; .*default, paper-demo, or give a setup file"):
        preset_of("magic")
    with pytest.raises(BadFile, match="cannot be read"):
        preset_of(str(tmp_path / "none.toml"))
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(BadFile, match="is not TOML"):
        preset_of(str(tmp_path / "bytes.toml"))


@pytest.mark.parametrize("text", ["base_tilt_deg", "=3", "base_tilt_deg=", ""])
def test_a_setting_without_name_or_value_is_refused(text):
    with pytest.raises(TrocarError, match="NAME=VALUE"):
        setting_of(text)
    assert setting_of("a=b=c") == ("a", "b=c")


def test_the_text_of_a_setup_file_is_toml_of_known_keys():
    values = tomllib.loads(setup_file(DEMO))
    assert values["preset"] == "default" and values["reward"]["margin"] == "clipped"
    assert values["set"]["theta_is"] == "entry" and values["set"]["base_tilt_deg"] == pytest.approx(20.3)
