"""Sessions and trials as units of work: shared models equal those of separate runs, and nothing is run twice."""

from dataclasses import replace

import pytest

from synthetic import config, prepared, synthetic_trial
from trocar.calibration.models import load_model
from trocar.errors import InvalidInput, TrocarError, UnknownName
from trocar.eval import jobs
from trocar.eval.config import RunConfig
from trocar.eval.folder import open_folder
from trocar.eval.jobs import SessionOrder, TrialOrder, calibrate, opened, play, play_run
from trocar.eval.prepare import CACHE, cable_file, cached_calibrations, prepare
from trocar.eval.staged import AGENT_ERROR
from trocar.eval.study import conditions_of, row_file
from trocar.eval.trial import trial_file
from trocar.eval.trials import Trials
from trocar.report.sweep import KIND
from trocar.sim.world import PhysicsError
from trocar.tasks.peg_transfer.task import PegTransfer

ONE = PegTransfer(transfers=1)


def test_a_shared_model_is_the_one_that_a_run_by_itself_fits(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE, str(tmp_path / "its own"))
    first, second = config(model="offset"), RunConfig(ONE, model="offset", calibration="joints", difficulty="mild")
    alone = tmp_path / "alone"
    prepare(second, 0, alone)
    monkeypatch.setenv(CACHE, str(tmp_path / "shared"))
    runs = ((first, tmp_path / "first"), (second, tmp_path / "second"))
    for run, folder in runs:
        open_folder(run, folder)
    fitted = []
    kind = type(load_model(cable_file(alone, 0, "psm1")))
    fit = kind.fit
    monkeypatch.setattr(kind, "fit", lambda *given: fitted.append(1) or fit(*given))
    calibrate(SessionOrder(runs, 0))
    assert len(fitted) == 1 and len(cached_calibrations()) == 1
    assert cable_file(tmp_path / "second", 0, "psm1").read_bytes() == cable_file(alone, 0, "psm1").read_bytes()


@pytest.fixture
def played(monkeypatch):
    """Replace trials by synthetic ones; return the list of those that were played."""
    done = []

    def run_trial(run, session, index, listener=None, **_):
        done.append((session.number, index))
        for name in ("transfer", "no grasp") if listener else ():
            listener({"name": name})
        return synthetic_trial(run, index, session=session.number)

    monkeypatch.setattr(jobs, "run_trial", run_trial)
    monkeypatch.setattr(jobs, "prepare", prepared)
    return done


def test_a_trial_that_is_there_is_not_run_again(tmp_path, played):
    run = config()
    open_folder(run, tmp_path)
    order = TrialOrder(run, tmp_path, 1, 2)
    assert play(order) == play(order) == ""
    assert played == [(1, 2)]
    order.path.write_bytes(b"half a trial")
    play(order)
    assert played == [(1, 2), (1, 2)]


def test_a_trial_whose_physics_broke_down_is_void_and_said(tmp_path, played, monkeypatch):
    break_trial(monkeypatch, 0)
    open_folder(config(), tmp_path)
    order = TrialOrder(config(), tmp_path, 0, 0)
    assert "physics became unstable at 0.200 s" in play(order)
    assert not order.path.exists()


def test_a_worker_that_does_not_see_the_folder_says_so(tmp_path):
    with pytest.raises(TrocarError, match="file system that all workers see"):
        play(TrialOrder(config(), tmp_path / "elsewhere", 0, 0))


def test_a_trial_whose_agent_failed_is_saved_and_told_by_its_file(tmp_path, played, monkeypatch):
    def failed(run, prepared, index, *_, **__):
        return replace(synthetic_trial(run, index, session=1), ended=AGENT_ERROR, reason="KeyError: 'a mistake'")

    monkeypatch.setattr(jobs, "run_trial", failed)
    run = config(sessions=2, trials=3)
    open_folder(run, tmp_path)
    order = TrialOrder(run, tmp_path, 1, 2)
    assert play(order) == f"{tmp_path}/session_01/trial_002.npz: KeyError: 'a mistake'; --raise stops there"
    assert order.path.is_file() and play(order) == ""


# A whole run.


@pytest.fixture
def elsewhere(monkeypatch):
    """Let this process do what others would; return the workers that were asked for."""
    asked = []
    monkeypatch.setattr(jobs, "pick_workers", lambda kind, count: asked.append((kind, count)))
    monkeypatch.setattr(jobs, "run_all", lambda work, units, workers: ((unit, work(unit)) for unit in units))
    return asked


def test_one_job_runs_trials_here_and_counts_their_goals(tmp_path, played, elsewhere):
    run, ticks = config(sessions=2, trials=2), []
    todo = open_folder(run, tmp_path)
    assert list(play_run(run, tmp_path, todo, tick=lambda *tick: ticks.append(tick))) == []
    assert played == [(0, 0), (0, 1), (1, 0), (1, 1)] and elsewhere == []
    assert {(work, of) for work, _, of, _ in ticks} == {("transfers", 4 * 12)}
    assert [(done, now) for _, done, _, now in ticks if "session 2" in now] == [
        (24, "session 2 of 2: setting up"),
        (24, "session 2, trial 1"),
        (25, "session 2, trial 1: a transfer has ended"),
        (36, "session 2, trial 1: saved"),
        (36, "session 2 of 2: setting up"),
        (36, "session 2, trial 2"),
        (37, "session 2, trial 2: a transfer has ended"),
        (48, "session 2, trial 2: saved"),
    ]
    assert open_folder(run, tmp_path) == []


def test_several_jobs_run_trials_elsewhere_after_each_session_was_set_up_once(tmp_path, played, elsewhere, monkeypatch):
    run, ticks, prepared = config(sessions=2, trials=2), [], []
    quickly = jobs.prepare

    def prepare(run, number, folder, **how):
        prepared.append(number)
        return quickly(run, number, folder, **how)

    monkeypatch.setattr(jobs, "prepare", prepare)
    todo = open_folder(run, tmp_path)
    assert list(play_run(run, tmp_path, todo, jobs=2, tick=lambda *tick: ticks.append(tick))) == []
    assert elsewhere == [("processes", 2)] and prepared[:2] == [0, 1] and len(played) == 4
    assert ticks == [
        *(("setting up sessions", done, 2) for done in range(3)),
        *(("running trials", done, 4) for done in range(5)),
    ]


def break_trial(monkeypatch, number):
    """Let the physics of all trials of a number break down."""
    quickly = jobs.run_trial

    def broken(run, session, index, *rest, **how):
        if index == number:
            raise PhysicsError(0.2)
        return quickly(run, session, index, *rest, **how)

    monkeypatch.setattr(jobs, "run_trial", broken)


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_wrong_with_a_trial_is_told_and_the_others_go_on(tmp_path, played, elsewhere, monkeypatch, count):
    break_trial(monkeypatch, 1)
    run = config(trials=3)
    (wrong,) = play_run(run, tmp_path, open_folder(run, tmp_path), jobs=count)
    assert wrong.startswith(str(tmp_path)) and "is void" in wrong
    assert open_folder(run, tmp_path) == [(0, 1)]


def test_a_study_calibrates_its_sessions_and_runs_what_is_missing(tmp_path, played, elsewhere, monkeypatch):
    methods, ticks, prepared = "calibrated,uncalibrated", [], []
    conditions = conditions_of(PegTransfer, tmp_path, values="unilateral", methods=methods, sessions=2, seed=2)
    _, (first, *_) = opened(conditions)
    play(first)
    quickly = jobs.prepare

    def prepare(run, number, folder, **how):
        prepared.append((run.method, number, len(played)))
        return quickly(run, number, folder, **how)

    monkeypatch.setattr(jobs, "prepare", prepare)
    assert jobs.run_study(conditions, KIND, None, lambda *tick: ticks.append(tick)) == []
    before = [(method, session) for method, session, trials in prepared if trials == 1]
    assert before[0] == ("calibrated", 1), "the first session is done, and who does not calibrate needs none"
    assert ticks[:2] == [("calibrating sessions", 1, 1), ("running trials", 1, 4)]
    assert ticks[2:] == [("running trials", done, 4) for done in (2, 3, 4)]
    assert played == [(0, 0), (0, 0), (1, 0), (1, 0)], "session by session"
    found = {row_file(trial_file(one.folder, *place)).is_file() for one in conditions for place in one.places}
    assert found == {True, False}, "the row of the trial that was there is made when the study is read"
    assert opened(conditions) == ([], [])


def test_a_trial_of_a_study_without_a_row_is_told_and_kept(tmp_path, played, elsewhere):
    def unreadable(trial):
        raise InvalidInput("this trial", "has no goals")

    conditions = conditions_of(PegTransfer, tmp_path, values="unilateral", methods="uncalibrated", trials=2)
    told = jobs.run_study(conditions, replace(KIND, made=unreadable), None, lambda *_: None)
    assert told == ["this trial has no goals"] * 2 and opened(conditions) == ([], [])


def test_a_program_runs_trials_gets_them_and_goes_on_where_it_was(tmp_path, played, monkeypatch):
    monkeypatch.chdir(tmp_path)
    how = {"method": "uncalibrated", "settings": {"settle_s": 0.2}, "seed": 4}
    trials = jobs.run("peg-transfer", variant="bilateral", trials=2, **how)
    assert isinstance(trials, Trials) and [trial.about["index"] for trial in trials] == [0, 1]
    about = trials[0].about
    assert (about["variant"], about["seed"], about["set"]) == ("bilateral", 4, ["settle_s=0.2"])
    (folder,) = (tmp_path / "out").iterdir()
    assert folder.name == f"peg-transfer-uncalibrated-4-{about['fingerprint'][:8]}"
    assert len(jobs.run("peg-transfer", variant="bilateral", trials=3, **how)) == 3
    assert played == [(0, 0), (0, 1), (0, 2)]


@pytest.mark.parametrize("name", ["speed", "laboratory", "chosen_method"])
def test_a_program_is_told_which_options_there_are(name):
    with pytest.raises(UnknownName, match=f"option '{name}' is unknown; .*budget_s.* seed.* variant"):
        jobs.run("peg-transfer", **{name: 1})


def test_a_program_is_warned_of_a_trial_that_failed_and_gets_the_others(tmp_path, played, monkeypatch):
    break_trial(monkeypatch, 0)
    with pytest.warns(UserWarning, match="is void: the physics became unstable"):
        trials = jobs.run("peg-transfer", out=tmp_path / "run", method="uncalibrated", trials=2)
    assert [trial.about["index"] for trial in trials] == [1]
