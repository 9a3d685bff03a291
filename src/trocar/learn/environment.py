"""The cell as a Gymnasium environment: any task, at a policy's rate, with the referee's reward."""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from numbers import Real
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from trocar.arms import fk
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.eval.config import JOINTS as FROM_JOINTS
from trocar.eval.config import RunConfig
from trocar.eval.method import objects_of
from trocar.eval.prepare import Prepared, prepare
from trocar.eval.run import compensate
from trocar.eval.scenery import Scenery
from trocar.eval.staged import StagedTrial, scenery_of
from trocar.eval.task import TASKS, Task
from trocar.learn.control import (
    IMAGES,
    OBJECTS,
    OBSERVATIONS,
    PRIVILEGED,
    STATE,
    Answer,
    Control,
    image_shape,
    observation_bounds,
    require_actions,
)
from trocar.learn.observed import Observation
from trocar.registry import load_plugin
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.offscreen import OffscreenCamera, handled
from trocar.sim.pace import Stepping
from trocar.sim.world import PhysicsError

REFEREE_S, REFEREE_SHARE = 1.0, 0.03
"""Least time between two scores by the referee, and least share of the time so far. A score goes through the whole
episode: with one per second, scoring took a quarter of the computing time of an episode of 100 s."""
MAX_INDEX = 2**31
SPARSE, DENSE = "sparse", "dense"
REWARDS = (SPARSE, DENSE)
DENSE_M = 0.1
"""Coming this much nearer to the next goal is worth as much as reaching a goal."""
FREE_M = 10.0
"""Bound of free bodies' positions on each axis; they may fall."""


class CellEnv(gymnasium.Env[dict[str, NDArray[Any]], NDArray[np.float32]]):
    """One task in the simulated cell.

    An episode is a trial: a session (cables, bases, cameras) and a scene. ``reset(seed=...)`` draws both; the same seed
    gives the same bytes, on any machine. An episode is ``terminated`` once the referee counts all goals as
    reached, and ``truncated`` when the task's budget is spent, or if the physics broke down (``info["void"]``).

    Args:
        task: name of the task.
        action: ``joints``: positions; ``cartesian``: increments of the tip's position and a rotation vector, in the
            world; ``cartesian-absolute``: position and quaternion x, y, z, w. Jaws are always absolute. Metres and rad.
        observation: ``state``, ``objects`` (what the task's perception finds), ``images``, ``privileged`` (the truth:
            poses of all free bodies), or several of them.
        reward: ``sparse``: number of goals that the referee newly counts as reached; ``dense``: in addition, 1 for each
            decimetre by which the remaining distance of the next goal shrinks: from the nearest working tip to the
            goal's object, and on to where the object belongs. It uses the truth.
        rate_hz: steps per second of the cell's clock.
        calibrated: whether the cables are compensated, below the actions, by a model fitted in each session.
        station: name or file of the station; empty: the task's.
        difficulty: ``mild``, ``recorded`` or ``harsh``.
        flaws: sizes of single flaws, such as ``registration=1.0mm``.
        calibration: with ``calibrated``, what cable models are fitted on, ``joints`` (the default) or ``images``.
        seed: seed of the sessions.
        sessions: number of sessions; each episode draws one of them.
        plugins: Python files that register the task or its parts.
        render_mode: ``rgb_array``: a picture; ``human``: a page in the browser.
        **options: options of the task, such as ``variant`` or ``budget_s``.

    Raises:
        InvalidInput: an option is unknown, or its value does not fit.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 30}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        *,
        action: str = "joints",
        observation: str | Sequence[str] = STATE,
        reward: str = SPARSE,
        rate_hz: float = 30.0,
        calibrated: bool = False,
        station: str = "",
        difficulty: str = "recorded",
        flaws: str | Sequence[str] = (),
        calibration: str = "",
        seed: int = 0,
        sessions: int = 10,
        plugins: str | Sequence[str] = (),
        render_mode: str | None = None,
        **options: Any,
    ):
        plugins, flaws, self._observed = _listed(plugins), _listed(flaws), _listed(observation)
        for plugin in plugins:
            load_plugin(plugin)
        self.render_mode = render_mode
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UnknownName("render_mode", str(render_mode), self.metadata["render_modes"])
        for name in self._observed or ("",):
            if name not in OBSERVATIONS:
                raise UnknownName("observation", name, OBSERVATIONS)
        if reward not in REWARDS:
            raise UnknownName("reward", reward, REWARDS)
        require_actions(action, rate_hz)  # before cables are fitted
        if not isinstance(calibrated, bool | np.bool_):
            raise InvalidValue("calibrated", repr(calibrated), "give True or False")
        if calibration and not calibrated:
            raise InvalidInput(f"calibration {calibration!r}", "fits no model", "drop it, or give calibrated=True")
        kind = TASKS.pick(task)
        self.config = RunConfig(
            _task(kind, options),
            method="policy-calibrated" if calibrated else "policy",
            calibration=(calibration or FROM_JOINTS) if calibrated else "",
            station=station,
            difficulty=difficulty,
            flaws=flaws,
            sessions=sessions,
            seed=seed,
            plugins=plugins,
        )
        self._action, self._rate_hz = action, rate_hz
        self.metadata = {**self.metadata, "render_fps": rate_hz}  # for one picture per step
        self._prepared: dict[int, Prepared] = {}
        self._folder: TemporaryDirectory[str] | None = None
        self._stepping: Stepping | None = None
        self._over = True
        self._page: Any = None
        self._draw: OffscreenCamera | None = None
        self._scenery: Scenery | None = None
        self._dense = reward == DENSE
        self._set_up(0, 0)
        goals = self.config.task.goals()
        if self._dense and goals and self._laboratory.task.errand(goals[0]) is None:
            self.close()
            remedy = "take the sparse one, or give its world a method errand(goal)"
            raise InvalidInput(f"task {self.config.task.name!r}", "has no dense reward", remedy)
        control, cell, world = self._control, self._laboratory.cell, self._laboratory.world
        self._bodies = world.free_bodies
        boxes = {name: spaces.Box(*_float32(low, high)) for name, (low, high, _) in self._bounds().items()}
        found: dict[str, spaces.Box[Any]] = dict(boxes) if STATE in self._observed else {}
        if self._observation.objects is not None:
            found[OBJECTS] = spaces.Box(-1.0, 1.0, (len(self._observation.objects.names),), np.float32)
        if IMAGES in self._observed:
            for name, camera in cell.cameras.items():
                found[f"{IMAGES}_{name}"] = spaces.Box(0, 255, image_shape(camera.model), np.uint8)
        if PRIVILEGED in self._observed:
            most = np.tile([FREE_M] * 3 + [1.001] * 4, len(self._bodies)).astype(np.float32)
            found[PRIVILEGED] = spaces.Box(-most, most)
        found["time_s"] = spaces.Box(0.0, float(self.config.task.budget_s) + 1.0, (1,), np.float32)
        self.observation_space = spaces.Dict(found)  # type: ignore[assignment,arg-type]
        self.action_space = spaces.Box(*_float32(control.low, control.high))
        self.action_names, self._goals = control.names, len(self.config.task.goals())

    def _bounds(self) -> dict[str, tuple[NDArray, NDArray, list[str]]]:
        return observation_bounds(self._laboratory.cell, self.config.arms)

    @property
    def observation_names(self) -> dict[str, list[str]]:
        """Return the names of the numbers in each part of an observation, except images."""
        names = {key: names for key, (_, _, names) in self._bounds().items() if key in self.observation_space.spaces}  # type: ignore[attr-defined]
        if self._observation.objects is not None:
            names[OBJECTS] = list(self._observation.objects.names)
        if PRIVILEGED in self._observed:
            axes = [*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")]
            names[PRIVILEGED] = [f"{body}.{axis}" for body in self._bodies for axis in axes]
        return names | {"time_s": ["time_s"]}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Draw a session and a scene; return the first observation and info.

        Args:
            seed: seed of this and the following episodes; None: the random stream goes on.
            options: ``session`` and ``trial``: numbers, as in ``trocar run`` with the same seed of the sessions.
        """
        super().reset(seed=seed)
        session, index = (int(self.np_random.integers(most)) for most in (self.config.sessions, MAX_INDEX))
        wanted = dict(options or {})
        session, index = wanted.pop("session", session), wanted.pop("trial", index)
        if wanted:
            raise UnknownName("option of reset()", next(iter(wanted)), ("session", "trial"))
        for name, value, most in (("session", session, self.config.sessions), ("trial", index, MAX_INDEX)):
            if isinstance(value, bool) or not (isinstance(value, int | np.integer) and 0 <= value < most):
                raise InvalidValue(f"the {name} of reset()", repr(value), f"give a whole number from 0 to {most - 1}")
        self._set_up(session, index)
        self._scored_s, self._reached, self._over = 0.0, 0, False
        self._scores: list[dict[str, Any]] = []
        self._referee(force=True)
        self._left_m = self._remaining_m()
        if self.render_mode == "human":
            self.render()
        return self._observed_now(), self._info(Answer())

    def _set_up(self, session: int, index: int) -> None:
        """Begin a trial."""
        self._stop()
        if session not in self._prepared:
            self._folder = self._folder or TemporaryDirectory(prefix="trocar-")
            self._prepared[session] = prepare(self.config, session, self._folder.name)
        prepared, config = self._prepared[session], self.config
        self._laboratory: SimLaboratory = StagedTrial(config, prepared, index).laboratory
        compensate(config, self._laboratory, prepared.models, prepared.priors)
        cell = self._laboratory.cell
        self._control = Control(cell, config.arms, self._action, self._rate_hz)
        parts = [part for part in self._observed if part != PRIVILEGED]
        self._observation = Observation(cell, self._control, parts, objects_of(config.task, cell))
        self._where, self._scenery, self._draw = (session, index), None, None
        self._stepping = self._laboratory.stepping(self._observation.watch if self._observation.looks else None)
        self._stepping.__enter__()
        gc.collect()  # a world's parts refer to one another, so that an hour of episodes would hold 1 GB

    def step(self, action: ArrayLike) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:  # type: ignore[override]
        """Play an action for one step; return observation, reward, terminated, truncated and info.

        The reward is the number of newly reached goals. The referee scores once a second, less often after half a
        minute, and at the end. A dense reward adds the progress towards the next goal.

        Raises:
            InvalidInput: the action has the wrong shape, is not finite or leaves its bounds (nothing has moved then);
                or no episode is running.
        """
        if self._over or self._stepping is None:
            raise InvalidInput("step()", "has no episode to go on with: none has begun, or it is over", "call reset()")
        values = self._control.checked(action)
        self._control.require_inside(values)
        answer, seconds, control = Answer(), self._control.next_step_s(), self._control
        self._stepping.call(lambda cell: control.act(values, answer))
        void = ""
        try:
            self._stepping.step(seconds)
        except PhysicsError as error:
            void = str(error)
        truncated = bool(void) or self._laboratory.now_s() >= self.config.task.budget_s - TICK_S / 2
        before, gained_m = self._reached, 0.0 if void else self._left_m - self._remaining_m()
        if not void:
            self._referee(force=truncated)
            self._left_m = self._remaining_m()
        terminated = bool(self._goals) and self._reached == self._goals and not void
        self._over = terminated or truncated
        if self.render_mode == "human":
            self.render()
        info = self._info(answer) | ({"void": void} if void else {})
        return self._observed_now(), float(self._reached - before + gained_m / DENSE_M), terminated, truncated, info

    def _remaining_m(self) -> float:
        """Return the remaining distance of the next goal; 0 if the reward is sparse."""
        goals = self.config.task.goals()
        open_goals = [goal for goal, score in zip(goals, self._scores, strict=True) if not score["succeeded"]]
        if not (self._dense and open_goals):
            return 0.0
        world, arms = self._laboratory.world, self.config.arms
        found = self._laboratory.task.errand(open_goals[0])
        assert found is not None  # checked in `__init__`
        tips = [world.T_world_base[arm] @ fk(world.models[arm], world.joints(arm)) for arm in arms]
        reach_m = min(float(np.linalg.norm(tip.translation_m - found[0])) for tip in tips)
        return reach_m + float(np.linalg.norm(found[1] - found[0]))

    def _referee(self, *, force: bool) -> None:
        """Score the episode so far, if a score is due."""
        now_s, laboratory = self._laboratory.now_s(), self._laboratory
        if force or now_s >= self._scored_s + max(REFEREE_S, REFEREE_SHARE * self._scored_s):
            scores = self.config.task.score(laboratory.truth(), laboratory.log.events)
            self._scored_s, self._scores = now_s, [asdict(score) for score in scores]
            self._reached = sum(bool(score.succeeded) for score in scores)

    def _observed_now(self) -> dict[str, NDArray[Any]]:
        found = self._observation.now()
        if PRIVILEGED in self._observed:
            poses = self._laboratory.world.free_poses()[:, [0, 1, 2, 4, 5, 6, 3]].ravel()  # wxyz to xyzw
            low, high = self.observation_space[PRIVILEGED].low, self.observation_space[PRIVILEGED].high  # type: ignore[index]
            if poses.shape != low.shape:
                problem = f"has {len(poses) // 7} free bodies, and another scene of it had {len(low) // 7}"
                raise InvalidInput(f"task {self.config.task.name!r}", problem, f"do not observe {PRIVILEGED!r}")
            found[PRIVILEGED] = np.clip(poses, low, high).astype(np.float32)
        return found

    def _info(self, answer: Answer) -> dict[str, Any]:
        session, index = self._where
        return {
            "time_s": self._laboratory.now_s(),
            "session": session,
            "trial": index,
            "slowed": dict(answer.slowed),
            "refused": dict(answer.refused),
            "score": self._reached / max(1, self._goals),
            "scores": self._scores,
            "collisions": len(self._laboratory.contacts.collisions()),
            "privileged": PRIVILEGED in self._observed,
        }

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Return a picture (height, width, 3), or show the cell on its page; for people, not for policies."""
        if self.render_mode is None:
            raise InvalidInput("render()", "has no mode", "make the environment with render_mode='rgb_array'")
        laboratory = self._laboratory
        if self._scenery is None:
            self._scenery = scenery_of(laboratory)
        now_s, arrays = laboratory.now_s(), laboratory.recorder.arrays(-1)
        if self.render_mode == "human":
            self._show(now_s, arrays)
            return None
        replay = self._scenery.shown(self.config.task.name, np.array([now_s]), arrays)
        if self._draw is None:
            from trocar.report.files import task_report  # Matplotlib only when needed

            report = task_report(self.config.task)
            tips = [tool.p_world_driven_m for name, tool in replay.tools.items() if name in self.config.arms]
            frame_m = np.concatenate([handled(replay), *tips])
            self._draw = OffscreenCamera(replay, report.view, report.colours, frame_m=frame_m)
        return self._draw.picture(now_s, replay)

    def _show(self, now_s: float, arrays: Mapping[str, NDArray[np.float64]]) -> None:
        from trocar.view.live import LiveView, Moment  # viser only when needed

        moment = Moment(now_s, arrays)
        if self._page is None or self._page[0] != self._where:
            if self._page is not None:
                self._page[1].close()
            assert self._scenery is not None  # made in `render`
            self._page = self._where, LiveView(self._scenery, self.config.task.name, moment)
        self._page[1].show(moment)

    @property
    def address(self) -> str:
        """Return where a browser finds the page of ``human``; empty without one."""
        return "" if self._page is None else f"http://127.0.0.1:{self._page[1].port}"

    def _stop(self) -> None:
        if self._stepping is not None:
            stepping, self._stepping = self._stepping, None
            stepping.__exit__(None, None, None)
        self._over = True

    def close(self) -> None:
        """End the cell, close its page and delete its files."""
        self._stop()
        if self._page is not None:
            self._page[1].close()
            self._page = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None
            self._prepared.clear()


def _task(kind: type[Task], options: Mapping[str, Any]) -> Task:
    known = tuple(kind.__dataclass_fields__)  # type: ignore[attr-defined]
    for name in options:
        if name not in known:
            raise UnknownName(f"option of the environment of {kind.name!r}", name, known)
        is_number = isinstance(kind.__dataclass_fields__[name].default, int | float)  # type: ignore[attr-defined]
        if is_number and not isinstance(options[name], Real):
            raise InvalidValue(name, repr(options[name]), "give a number")
    return kind(**options)


def _listed(values: str | Sequence[str]) -> tuple[str, ...]:
    """Return one name, or several, as a tuple."""
    return (values,) if isinstance(values, str) else tuple(map(str, values))


def _float32(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return low.astype(np.float32), high.astype(np.float32)
