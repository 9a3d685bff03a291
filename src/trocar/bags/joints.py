"""Calibration recordings from a bag: where an arm's joints were commanded, and where they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.bags.reader import NS_PER_S, Bag, stamp_ns
from trocar.calibration.recording import NO_MOTION_RAD, Recording
from trocar.errors import InvalidInput, UnknownName

JOINT_STATE = "sensor_msgs/JointState"
JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
"""Names of a PSM's joints, q1 to q6; ``outer_yaw`` (before dVRK 2.3) and ``psm1_yaw`` are understood as well."""
COMMANDED = ("setpoint_js", "servo_jp", "move_jp")
"""CRTK's topics with commands, the most informative first: what the controller held, then what it was sent."""
TARGETS = "move_jp"
"""The one of them whose commands are the goals of motions, not set-points on the way."""
MEASURED = "measured_js"
COMMANDS = ("setpoint_", "servo_", "move_")
"""Prefixes of CRTK's topics by which a namespace is known to be an arm's."""
DVRK_1_ENCODERS = "state_joint_current"
TRUTH = "true_js"
"""Where the joints of a simulated trial really were, in the arm's namespace."""


@dataclass(frozen=True)
class Choice:
    """The topics from which a recording is made."""

    commanded: str
    measured: str
    encoders: bool = False
    """Whether, by its topic's name, ``measured`` comes from the arm's own encoders, which do not see cable errors."""


@dataclass(frozen=True, eq=False)
class JointSeries:
    """The joints of one topic.

    Attributes:
        stamps_ns: (n,) of their headers, non-decreasing.
        q: (n, 6), rad and m.
        unstamped: how many messages had a stamp of 0, which CRTK calls not valid; they are left out.
        empty: how many had no positions, or one that is not a number; they are left out.
        late: how many came with an earlier stamp than the message before; they are put in order.
        unnamed: how many did not name their joints; the six are taken as q1 to q6.
        unfit: how many had other joints, or not a position for each name; they are left out.
    """

    stamps_ns: NDArray[np.int64]
    q: NDArray[np.float64]
    unstamped: int
    empty: int
    late: int
    unnamed: int
    unfit: int


@dataclass(frozen=True, eq=False)
class Imported:
    """A recording from a bag.

    Attributes:
        recording: times in s after the bag's beginning; one row for each measurement, with the last command before it,
            and one without a measurement for each command that was replaced before the next measurement.
        commanded: of the topic with commands.
        measured: of the topic with measurements.
        early: measurements before the first command, left out.
        between: rows without a measurement.
        moving: measurements that are not valid because their command had not stood still for long enough.
    """

    recording: Recording
    commanded: JointSeries
    measured: JointSeries
    early: int
    between: int
    moving: int


def choose(bag: Bag, namespace: str = "", commanded: str = "", measured: str = "") -> Choice:
    """Return the topics of an arm: those given, the others by their names in CRTK.

    Args:
        bag: with the topics.
        namespace: of the arm, such as ``/PSM1``; empty: that of the topic given, or else of the only arm in the bag.
        commanded: topic with commands; empty: the first of :data:`COMMANDED` in the namespace.
        measured: topic with measurements; empty: ``measured_js`` in the namespace.

    Raises:
        InvalidInput: there is no such topic, it does not hold joints, the bag holds no arm or several, or the arm was
            sent commands of two kinds.
    """
    sent, seen = commanded, measured
    if not (commanded and measured):
        arm = f"/{namespace.strip('/')}" if namespace.strip("/") else _arm(bag, commanded, measured)
        sent, seen = commanded or _commands(bag, arm), measured or f"{arm}/{MEASURED}"
    for name in (sent, seen):
        bag.topic(name, JOINT_STATE)
    if sent == seen:
        raise InvalidInput(f"topic {seen!r}", "cannot be commanded and measured at once", "name two topics")
    return Choice(sent, seen, not measured or _of_encoders(bag, measured))


def arms_in(bag: Bag, commanded: bool = True, measured: bool = True) -> list[str]:
    """Return the namespaces of arms, not of jaws, with topics of commands and of measurements, as far as required."""
    names = {topic.name for topic in bag.of_kind(JOINT_STATE)}
    return [
        arm
        for arm in sorted({_parent(name) for name in names})
        if not arm.endswith("/jaw")
        and (not commanded or any(f"{arm}/{name}" in names for name in COMMANDED))
        and (not measured or f"{arm}/{MEASURED}" in names)
    ]


def read_recording(bag: Bag, choice: Choice, order: Sequence[str] = (), settled_s: float = 0.0) -> Imported:
    """Return the recording of two topics.

    The command at a measurement is that of the last message before it (zero-order hold), by the stamps of the headers.
    Differences between the clocks of several machines are not corrected.

    Args:
        bag: with the topics.
        choice: the topics.
        order: names of six joints as the messages have them, q1 to q6; empty: as :data:`JOINTS`.
        settled_s: a measurement is valid only if its command has stood still for this long.

    Raises:
        InvalidInput: no message names these joints, none is valid, the topics do not overlap in time, or the commands
            are only the ends of motions and ``settled_s`` is 0.
        BadFile: the bag is damaged.
    """
    if choice.commanded.rpartition("/")[2] == TARGETS and settled_s <= 0:
        problem = "holds the ends of motions, and measurements on the way there do not belong to them"
        remedy = f"give --settled (settled_s), longer than any motion takes, or record {COMMANDED[0]}"
        raise InvalidInput(f"topic {choice.commanded!r}", problem, remedy)
    if order and (len(order) != 6 or len(set(order)) < 6):
        raise InvalidInput(f"the order {','.join(order)!r}", "does not name six joints", "give six names, q1 to q6")
    sent, seen = (_series(bag, name, order) for name in (choice.commanded, choice.measured))
    early = int(np.searchsorted(seen.stamps_ns, sent.stamps_ns[0]))
    if early == len(seen.q):
        problem = (
            f"{(sent.stamps_ns[0] - seen.stamps_ns[-1]) / NS_PER_S:.3f} s after the last measurement of "
            f"{choice.measured!r}, by the stamps"
        )
        raise InvalidInput(f"the first command of {choice.commanded!r} comes", problem, "record both at the same time")
    seen_ns = seen.stamps_ns[early:]
    held = np.searchsorted(sent.stamps_ns, seen_ns, side="right") - 1
    changes = _changes(sent.q)
    still_ns = seen_ns - sent.stamps_ns[changes[np.searchsorted(changes, held, side="right") - 1]]
    settled = still_ns >= settled_s * NS_PER_S
    between = np.setdiff1d(changes[changes < held[-1]], held)
    stamps_ns = np.concatenate([sent.stamps_ns[between], seen_ns])
    rows = np.argsort(stamps_ns, kind="stable")
    recording = Recording(
        q_cmd=sent.q[np.concatenate([between, held])][rows],
        q_phy=np.concatenate([np.full((len(between), 6), np.nan), seen.q[early:]])[rows],
        valid=np.concatenate([np.zeros(len(between), dtype=bool), settled])[rows],
        t_s=(stamps_ns[rows] - bag.start_ns) / NS_PER_S,
        name=bag.path.stem,
    )
    recording.require_units()
    return Imported(recording, sent, seen, early, len(between), int(np.sum(~settled)))


def _commands(bag: Bag, arm: str) -> str:
    """Return the topic with an arm's commands; if there is none, the one that should be there."""
    known = {topic.name for topic in bag.of_kind(JOINT_STATE)}
    first, *others = [name for name in COMMANDED if f"{arm}/{name}" in known] or COMMANDED[:1]
    if others and first != COMMANDED[0]:
        problem = f"was sent commands both in {first} and in {others[0]}"
        remedy = f"choose one, such as --commanded {arm}/{first}, or record {COMMANDED[0]}, which holds both"
        raise InvalidInput(f"arm {arm!r}", problem, remedy)
    return f"{arm}/{first}"


def _of_encoders(bag: Bag, topic: str) -> bool:
    """Return whether a given topic is, by its name, one of an arm's encoders."""
    arm, _, name = topic.rpartition("/")
    beside = [other.rpartition("/")[2] for other in bag.topics if _parent(other) == arm]
    return name == DVRK_1_ENCODERS or (name != TRUTH and any(other.startswith(COMMANDS) for other in beside))


def _arm(bag: Bag, commanded: str, measured: str) -> str:
    """Return the arm of the topic that was given (one of the two at most), or else the only arm in the bag."""
    arms = arms_in(bag, not commanded, not measured)
    given = commanded or measured
    if given and _parent(given) in arms:
        return _parent(given)
    item = f"bag {str(bag.path)!r}"
    if not arms:
        other = ", ".join(topic.name for topic in bag.of_kind(JOINT_STATE)) or "none"
        problem = f"holds no arm by the names of CRTK, {MEASURED} and {' or '.join(COMMANDED)}; joints are in: {other}"
        raise InvalidInput(item, problem, "name two of them with --commanded and --measured")
    if len(arms) > 1:
        raise InvalidInput(item, f"holds the arms {', '.join(arms)}", f"choose one, such as --namespace {arms[0]}")
    return arms[0]


def _changes(q: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the rows (k,) in which commands (n, 6) change; row 0 counts.

    Each row is compared with the last change: compared with the row before, a slow motion would be none.
    """
    changes = [0]
    for row in range(1, len(q)):
        if np.abs(q[row] - q[changes[-1]]).max() > NO_MOTION_RAD:
            changes.append(row)
    return np.array(changes)


def _series(bag: Bag, topic: str, order: Sequence[str]) -> JointSeries:
    stamps, rows = [], []
    unstamped = empty = unnamed = unfit = 0
    places: dict[tuple[tuple[str, ...], int], list[int] | InvalidInput] = {}
    for _, message in bag.messages([topic]):
        names, position = tuple(message.name), np.asarray(message.position, dtype=np.float64)
        if not stamp_ns(message):
            unstamped += 1
            continue
        if not len(position):
            empty += 1
            continue
        kind = names, len(position)
        if kind not in places:
            places[kind] = _places(topic, names, len(position), order)
        place = places[kind]
        if isinstance(place, InvalidInput):
            unfit += 1
            continue
        q = position[place]
        if not np.isfinite(q).all():
            empty += 1
            continue
        unnamed += not names
        stamps.append(stamp_ns(message))
        rows.append(q)
    if not rows:
        raise _nothing_in(topic, list(places.values()), unstamped, empty)
    stamps_ns = np.array(stamps, dtype=np.int64)
    in_order = np.argsort(stamps_ns, kind="stable")
    late = int(np.sum(np.diff(stamps_ns) < 0))
    return JointSeries(stamps_ns[in_order], np.array(rows)[in_order], unstamped, empty, late, unnamed, unfit)


def _nothing_in(topic: str, places: Sequence[list[int] | InvalidInput], unstamped: int, empty: int) -> InvalidInput:
    """Return why a topic has no valid joints: what is wrong with the first ones that do not fit, or what is missing."""
    wrong = next((place for place in places if isinstance(place, InvalidInput)), None)
    counts = f"{unstamped} with a stamp of 0, which CRTK calls not valid, and {empty} without positions"
    problem = f"holds no valid joints: {counts}"
    return wrong or InvalidInput(f"topic {topic!r}", problem, "name another, or record it again")


def _places(topic: str, names: tuple[str, ...], count: int, order: Sequence[str]) -> list[int] | InvalidInput:
    """Return the indices of q1 to q6 in a message's positions, or why they cannot be told."""
    item = f"topic {topic!r}"
    if not names and (count != 6 or order):
        problem = f"does not name its {count} joints"
        return InvalidInput(item, problem, "only six unnamed joints can be used, as q1 to q6")
    if missing := [name for name in order if name not in names]:
        return UnknownName(f"joint of {item}", missing[0], names)
    meant = list(names) if order else [_meant(name) for name in names] or list(JOINTS)
    wanted = order or JOINTS
    if any(meant.count(joint) != 1 for joint in wanted):
        listed = ", ".join(repr(name)[1:-1] for name in names)  # from a damaged bag, of any characters
        problem = f"has the joints {listed}, not once each of {', '.join(wanted)}"
        return InvalidInput(item, problem, "name six of them with --joints, q1 to q6")
    if count != len(meant):
        problem = f"has a message of {len(names)} names and {count} positions"
        return InvalidInput(item, problem, "record a topic that has a position for each name")
    return [meant.index(joint) for joint in wanted]


def _meant(name: str) -> str:
    """Return the joint that a name means: the longest joint's name that it equals, or ends in after a prefix."""
    fits = [joint for joint in JOINTS if name.lower() == joint or name.lower().endswith(f"_{joint}")]
    return max(fits, key=len, default="")


def _parent(topic: str) -> str:
    return topic.rpartition("/")[0]
