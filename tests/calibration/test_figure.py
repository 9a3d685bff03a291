import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from trocar.calibration import evaluation as module
from trocar.calibration.evaluation import Evaluation, draw_evaluation, wrist
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import walk

COMMANDED, MEASURED, PREDICTED = "#8a8f98", "#1f6fb4", "#d9541e"


@pytest.fixture(scope="module")
def recording():
    q, valid = walk(0, 200), np.ones(200, bool)
    valid[[0, 1, 50]] = False
    return Recording(q, q + np.linspace(0.01, 0.06, 6), valid, 0.5 * np.arange(200.0) + 7.0, "mine")


@pytest.fixture(scope="module")
def axes(recording):
    figure = Figure()
    wrist(figure, recording, Evaluation("offset", recording, recording.q_cmd + 0.02, 1.0))
    return figure.axes


def lines_of(axis):
    return {line.get_label(): line for line in axis.lines}


def test_each_joint_of_the_wrist_has_its_way_over_time(recording, axes):
    rows = np.flatnonzero(recording.valid)
    for row, joint in enumerate((3, 4, 5)):
        lines = lines_of(axes[2 * row])
        assert lines.keys() == {"commanded", "measured", "predicted"}
        for label, values in (
            *(("commanded", recording.q_cmd), ("measured", recording.q_phy)),
            ("predicted", recording.q_cmd + 0.02),
        ):
            assert_allclose(lines[label].get_xdata(), 0.5 * (rows - rows[0]))
            assert_allclose(lines[label].get_ydata(), values[rows, joint])
        assert [lines[label].get_linestyle() for label in ("commanded", "measured", "predicted")] == ["-", "-", "--"]
        assert [lines[label].get_color() for label in lines] == [COMMANDED, MEASURED, PREDICTED]


def test_beside_it_are_its_loops_of_the_first_rows(recording, axes):
    first = np.flatnonzero(recording.valid)[:160]
    for row, joint in enumerate((3, 4, 5)):
        lines = lines_of(axes[2 * row + 1])
        assert lines.keys() == {"measured", "predicted"}
        for label, error in (("measured", 0.01 * (joint + 1)), ("predicted", 0.02)):
            assert_allclose(lines[label].get_xdata(), recording.q_cmd[first, joint])
            assert_allclose(lines[label].get_ydata(), error, atol=1e-12)
        assert "first 160 rows" in axes[2 * row + 1].get_title()


def test_axes_are_named_and_errors_told(axes):
    for row, (joint, words) in enumerate((("q4", "roll"), ("q5", "wrist pitch"), ("q6", "wrist yaw"))):
        over_time, loops = axes[2 * row], axes[2 * row + 1]
        error = 0.01 * (row + 4)
        assert over_time.get_title().startswith(f"{joint} {words}: RMSE {error:.4f} rad uncorrected, ")
        assert over_time.get_title().endswith(f"{abs(error - 0.02):.4f} rad predicted")
        assert over_time.get_ylabel() == f"{joint} [rad]" and loops.get_ylabel() == f"{joint} - command [rad]"
        for axis in (over_time, loops):
            assert not axis.spines["top"].get_visible() and not axis.spines["right"].get_visible()
        assert over_time.get_position().x0 < loops.get_position().x0
        assert over_time.get_position().width > 2 * loops.get_position().width
    assert [axis.get_legend() is not None for axis in axes] == [True, True, False, False, False, False]
    assert [axis.get_xlabel() for axis in axes] == ["", "", "", "", "time [s]", "commanded joint [rad]"]
    assert axes[0].figure.get_suptitle() == "mine: cable model 'offset' on 197 rows"


def test_without_a_model_the_measurements_are_beside_the_commands(recording):
    figure = Figure()
    wrist(figure, recording)
    assert lines_of(figure.axes[0]).keys() == {"commanded", "measured"}
    assert figure.axes[2].get_title() == "q5 wrist pitch: RMSE 0.0500 rad, measured against commanded"
    assert figure.get_suptitle() == "mine: 197 rows"


def test_nothing_good_is_nothing_to_draw(recording):
    empty = Recording(recording.q_cmd, recording.q_phy, np.zeros(200, bool), recording.t_s, "mine")
    with pytest.raises(TrocarError, match=r"mine has no valid row to be drawn \(200 are marked as not valid\)"):
        wrist(Figure(), empty)


def test_a_picture_is_written_where_it_is_asked_for(recording, monkeypatch, tmp_path):
    written = []
    monkeypatch.setattr(module, "write_figure", lambda path, figure: written.append(figure) or path)
    evaluation = Evaluation("offset", recording, recording.q_cmd, 1.0)
    assert draw_evaluation(evaluation, tmp_path / "one.png") == tmp_path / "one.png"
    width, height = written[0].get_size_inches() * written[0].dpi
    assert len(written[0].axes) == 6 and 1200 < width < 2000 and 800 < height < 1200
