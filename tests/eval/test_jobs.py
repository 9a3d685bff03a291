"""Sessions and trials as units of work: shared models equal those of separate runs, and nothing is run twice."""

import pickle

import pytest

from synthetic import config, synthetic_trial
from trocar.calibration.models import load_model
from trocar.errors import TrocarError
from trocar.eval import jobs
from trocar.eval.config import RunConfig
from trocar.eval.folder import open_folder
from trocar.eval.jobs import SessionOrder, TrialOrder, calibrate, play
from trocar.eval.prepare import CACHE, Prepared, cable_file, cached_calibrations, calibration_key, prepare
from trocar.sim.world import PhysicsError
from trocar.tasks.peg_transfer.task import PegTransfer

ONE = PegTransfer(transfers=1)


def test_a_run_can_be_handed_to_another_process():
    run = RunConfig(PegTransfer(transfers=3, budget_s=99.0), seed=4, sessions=2, model="offset", flawless_camera=True)
    again = pickle.loads(pickle.dumps(run))
    assert again.fingerprint == run.fingerprint
    assert (again.sessions, again.task) == (2, run.task)


def test_a_run_of_a_plugin_brings_it_along(registries, tmp_path):
    plugin = tmp_path / "mine.py"
    plugin.write_text("from trocar.motion import PLANNERS\nPLANNERS.register('mine', PLANNERS['spline'])\n")
    from trocar.registry import load_plugin

    load_plugin(plugin)
    run = config(planner="mine", plugins=(str(plugin),))
    assert pickle.loads(pickle.dumps(run)).fingerprint == run.fingerprint


def test_models_are_shared_where_nothing_differs_that_they_depend_on():
    run = config(model="offset")
    same = [
        RunConfig(ONE, model="offset", calibration="joints", difficulty="mild"),
        config(model="offset", planner="spline", new_session=True, trials=5),
        config(model="offset", method="optimized", settings=("settle_s=0.2",)),
    ]
    other = [config(model="ridge"), config(model="offset", seed=1), config(model="offset", flawless_camera=True)]
    key = calibration_key(run, 0, "psm1")
    assert {calibration_key(one, 0, "psm1") for one in same} == {key}
    assert key not in {calibration_key(one, 0, "psm1") for one in other} | {calibration_key(run, 1, "psm1")}


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


def test_a_damaged_or_forbidden_cache_is_no_trouble(tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    monkeypatch.setenv(CACHE, str(cache))
    run = config(model="offset")
    prepare(run, 0, tmp_path / "first")
    (known,) = cached_calibrations()
    known.write_bytes(b"half a model")
    prepare(run, 0, tmp_path / "second")
    monkeypatch.setenv(CACHE, str(known))  # a file: nothing can be kept in it
    prepare(run, 0, tmp_path / "third")
    files = [cable_file(tmp_path / name, 0, "psm1").read_bytes() for name in ("first", "second", "third")]
    assert files[0] == files[1] == files[2]


@pytest.fixture
def played(monkeypatch):
    """Replace trials by synthetic ones; return the list of those that were played."""
    done = []

    def run_trial(run, prepared, index, *_, **__):
        done.append((prepared.number, index))
        return synthetic_trial(run, index, session=prepared.number)

    def without_simulator(run, number, folder, **_):
        (folder / f"session_{number:02d}").mkdir(exist_ok=True)
        return Prepared(number, None, {})

    monkeypatch.setattr(jobs, "run_trial", run_trial)
    monkeypatch.setattr(jobs, "prepare", without_simulator)
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
    def broken(*_, **__):
        raise PhysicsError(0.2)

    monkeypatch.setattr(jobs, "run_trial", broken)
    open_folder(config(), tmp_path)
    order = TrialOrder(config(), tmp_path, 0, 0)
    assert "physics became unstable at 0.200 s" in play(order)
    assert not order.path.exists()


def test_a_worker_that_does_not_see_the_folder_says_so(tmp_path):
    with pytest.raises(TrocarError, match="file system that all workers see"):
        play(TrialOrder(config(), tmp_path / "elsewhere", 0, 0))
