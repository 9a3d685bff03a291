"""``trocar run --robot``: what is refused, and what a person is told, before anything could move."""

from types import SimpleNamespace

import pytest
import typer

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.cli.robot import about_motion, run_robot
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.eval.config import RunConfig
from trocar.lab import station_text
from trocar.tasks.peg_transfer.task import PegTransfer


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(station_text("peg-transfer") + "\n[crtk]\ndomain = 44\n", encoding="utf-8")
    return f"crtk:{path}"


def test_a_person_is_told_what_moves_where_and_how_fast(robot):
    config = RunConfig(PegTransfer(), method="uncalibrated", robot=robot)
    told = "\n".join(about_motion("peg-transfer", robot, config.laboratory, config.arms))
    assert "psm1 works: /PSM1/servo_jp over ROS 2 on 127.0.0.1, domain 44, at 100 Hz" in told
    assert "psm2 is held where it is: /PSM2/servo_jp" in told
    assert "yaw 6.28 rad/s" in told and "x -150 to 150 mm" in told


def test_options_of_simulated_sessions_are_refused(robot):
    for option in ({"sessions": 2}, {"difficulty": "harsh"}, {"station": "peg-transfer"}, {"flaws": ("jaw=1",)}):
        with pytest.raises(InvalidInput, match=r"is for simulated sessions, and --robot crtk:.* drives real arms"):
            RunConfig(PegTransfer(), method="uncalibrated", robot=robot, **option)


def test_a_method_that_compensates_needs_a_cable_model_of_each_arm(robot, tmp_path):
    with pytest.raises(
        InvalidInput, match=r"cables of psm1, and no model of them is named; give --cables psm1=FILE.npz"
    ):
        RunConfig(PegTransfer(), robot=robot)
    with pytest.raises(BadFile, match="does not exist"):
        RunConfig(PegTransfer(), robot=robot, cables=(f"psm1={tmp_path}/none.npz",))
    (tmp_path / "some.npz").write_bytes(b"")
    with pytest.raises(UnknownName):
        RunConfig(PegTransfer(), robot=robot, cables=(f"psm7={tmp_path}/some.npz",))
    with pytest.raises(InvalidInput, match="has no effect with --method uncalibrated"):
        RunConfig(PegTransfer(), method="uncalibrated", robot=robot, cables=(f"psm1={tmp_path}/some.npz",))


def test_cables_without_a_robot_and_robots_without_a_file_are_refused():
    with pytest.raises(InvalidInput, match="is of a real arm, and --robot names none"):
        RunConfig(PegTransfer(), cables=("psm1=x.npz",))
    with pytest.raises(InvalidInput, match=r"names no station's file; give KIND:STATION.toml"):
        RunConfig(PegTransfer(), robot="crtk")
    with pytest.raises(UnknownName):
        RunConfig(PegTransfer(), robot="nobody:x.toml")


def test_a_robots_run_says_so_and_nothing_of_simulated_flaws(robot):
    about = RunConfig(PegTransfer(), method="uncalibrated", robot=robot).about()
    assert about["robot"] == "crtk" and about["flaws"] == {} and about["difficulty"] == []
    assert "robot" not in RunConfig(PegTransfer(), method="uncalibrated").about()


@pytest.mark.parametrize(("fault", "begun"), [("following", 1), ("others", 1), ("late", 3)])
def test_after_a_fault_that_lasts_no_other_trial_begins_by_itself(fault, begun, robot, tmp_path, monkeypatch):
    import trocar.cli.robot
    import trocar.eval.on_robot

    trials = []

    def trial(config, index, *_):
        trials.append(index)
        event = {"name": "fault", "arm": "psm1", "fault": fault, "reason": "something is wrong", "time_s": 1.0}
        return SimpleNamespace(events=[event], ended="FAULT", save=lambda path: None)

    monkeypatch.setattr(trocar.eval.on_robot, "run_on_robot", trial)
    monkeypatch.setattr(trocar.cli.robot, "finish", lambda *_, **__: True)
    config = RunConfig(PegTransfer(), method="uncalibrated", robot=robot, trials=3)
    how = {"out": tmp_path / "out", "strict": False, "as_json": True, "enable_motion": True, "yes": True}
    if begun < 3:
        with pytest.raises(typer.Exit):
            run_robot(config, **how)
    else:
        run_robot(config, **how)
    assert len(trials) == begun


def test_a_trial_is_kept_before_a_person_is_asked_how_it_went(robot, tmp_path, monkeypatch):
    import trocar.cli.robot
    import trocar.eval.on_robot

    def trial(config, index, *_):
        return SimpleNamespace(events=[], scores=[{}], about={}, ended="done", goal_noun="transfer", save=saved)

    def saved(path):
        kept.append(path.name)

    def gone(*_):
        raise typer.Abort

    kept = []
    monkeypatch.setattr(trocar.eval.on_robot, "run_on_robot", trial)
    monkeypatch.setattr(trocar.cli.robot, "agreed", lambda *_, **__: True)
    monkeypatch.setattr(trocar.cli.robot.typer, "confirm", lambda *_, **__: True)
    monkeypatch.setattr(trocar.cli.robot, "_tally", gone)
    config = RunConfig(PegTransfer(), method="uncalibrated", robot=robot)
    with pytest.raises(typer.Exit) as stopped:
        run_robot(config, tmp_path / "out", strict=False, as_json=False, enable_motion=True, yes=False)
    assert kept == ["trial_000.npz"] and stopped.value.exit_code == 130


@pytest.mark.parametrize(("answer", "code"), [(False, 1), (typer.Abort(), 130)])
def test_a_person_who_does_not_want_it_to_begin_is_not_told_to_make_trials(
    answer, code, robot, tmp_path, monkeypatch, capsys
):
    import trocar.cli.robot

    def asked(*_, **__):
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(trocar.cli.robot, "agreed", lambda *_, **__: True)
    monkeypatch.setattr(trocar.cli.robot.typer, "confirm", asked)
    config = RunConfig(PegTransfer(), method="uncalibrated", robot=robot)
    with pytest.raises(typer.Exit) as left:
        run_robot(config, tmp_path / "out", strict=False, as_json=False, enable_motion=True, yes=False)
    assert left.value.exit_code == code and "before the first trial" in capsys.readouterr().err


def test_nothing_moves_unless_motion_is_enabled_and_somebody_agrees(robot, tmp_path, monkeypatch):
    import trocar.eval.on_robot

    class Moved(Exception):
        pass

    def moved(*_):
        raise Moved

    monkeypatch.setattr(trocar.eval.on_robot, "run_on_robot", moved)
    config = RunConfig(PegTransfer(), method="uncalibrated", robot=robot)
    how = {"out": tmp_path / "out", "strict": False, "as_json": True}
    with pytest.raises(InvalidInput, match="moves real arms, and motion is not enabled; add --enable-motion"):
        run_robot(config, enable_motion=False, yes=True, **how)
    with pytest.raises(InvalidInput, match="nobody is there to answer; add --yes"):
        run_robot(config, enable_motion=True, yes=False, **how)
    with pytest.raises(Moved):
        run_robot(config, enable_motion=True, yes=True, **how)
