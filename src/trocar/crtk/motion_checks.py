"""Checks of what an arm says about itself: joints, units, frames, state."""

from __future__ import annotations

import numpy as np

from trocar.crtk.dialect import INSERT, NO_INSTRUMENT, jaw_topic, joint_names, loop_settings, plain_name
from trocar.crtk.explaining import FRAME_M, FRAME_RAD, POSE_M, POSE_RAD, Cause, apart, frame_of, near
from trocar.crtk.heard_arm import ArmHeard, Finding
from trocar.crtk.messages import JointState
from trocar.geometry import shown
from trocar.hardware.arm import DrivenArm, LoopSettings
from trocar.hardware.laboratory import registered

RANGE_SHARE, JAW_RAD = 5e-3, 0.02
"""How far readings may be outside their range: of a joint, as a share of the range; of the jaws."""
SPEED_SHARE = 2.0
"""Share of its greatest speed with which a joint may seem to move."""
REST = 1e-4
"""rad, m: an arm whose set-points differ by less is at rest."""
STATES = ("DISABLED", "ENABLED", "PAUSED", "FAULT")
SAMPLES = 20
USUAL = LoopSettings()


def state(about: ArmHeard) -> Finding:
    """Judge whether the arm is enabled and homed."""
    last = about.last("operating_state")
    if last is None:
        return Finding(None, "it did not come")
    found = f"{last.state}, {'homed' if last.is_homed else 'not homed'}"
    if last.state not in STATES:
        return Finding(False, found, f"CRTK has {', '.join(STATES)}: the robot's software is of another kind")
    return Finding(last.state == "ENABLED" and last.is_homed, found, "enable and home it at its console")


def busy(about: ArmHeard) -> Finding:
    """Judge whether an arm at rest says that it is not busy."""
    last, (_, q) = about.last("operating_state"), about.joints("setpoint_js")
    if last is None or len(q) == 0:
        return Finding(None, "state or set-point did not come")
    moves = float(np.ptp(q, axis=0).max()) > REST
    if moves:
        return Finding(None, "it moves")
    remedy = "hold it, or disable and enable it: who waits for the end of a motion waits for ever"
    return Finding(not last.is_busy, "busy" if last.is_busy else "not busy", remedy)


def finite(about: ArmHeard) -> Finding:
    """Judge whether everything is a number."""
    messages = [(topic, one) for topic, come in about.streams.items() for _, one in come if isinstance(one, JointState)]
    wrong = [topic for topic, one in messages if not np.isfinite([*one.position, *one.velocity, *one.effort]).all()]
    found = f"{len(wrong)} of {len(messages)} messages are not, of {wrong[0]}" if wrong else "all"
    if not messages:
        return Finding(None, "nothing came")
    return Finding(not wrong, found, "do not move it: look for a broken encoder, or one that is not connected")


def names(about: ArmHeard) -> Finding:
    """Judge names and number of the joints."""
    dialect = about.topics.dialect
    wanted, jaw = joint_names(dialect), jaw_topic(dialect, about.topic)
    for topic in (f"{about.topic}/measured_js", f"{about.topic}/setpoint_js", f"{jaw}/measured_js"):
        if topic not in about.streams:
            continue
        one, count = about.streams[topic][-1][1], 1 if topic.startswith(f"{jaw}/") else len(wanted)
        if NO_INSTRUMENT in one.name:
            return Finding(False, f"{topic} has {', '.join(one.name)}: the arm has no instrument", INSERT)
        if len(one.position) < count or (count > 1 and len(one.position) > count):
            remedy = "choose the arm's model in the station's file, or its namespace"
            return Finding(False, f"{topic} has {len(one.position)} positions instead of {count}", remedy)
        if count > 1 and sorted(plain_name(dialect, name) for name in one.name) != sorted(wanted):
            remedy = f"the names should be {', '.join(wanted)}; positions are taken in this order, so check the order"
            return Finding(False, f"{topic} has {', '.join(one.name) or 'no names'}", remedy)
    if f"{about.topic}/measured_js" not in about.streams:
        return Finding(None, "nothing came")
    one = about.streams[f"{about.topic}/measured_js"][-1][1]
    there = tuple(plain_name(dialect, name) for name in one.name)
    return Finding(True, "as they should be" if there == wanted else "in another order, told by their names")


def units(about: ArmHeard) -> Finding:
    """Judge whether lengths are in m and angles in rad."""
    return _explained(about, Cause.UNITS, "joints and poses agree", "publish rad and m (CRTK is in SI units)")


def order(about: ArmHeard) -> Finding:
    """Judge whether positions are in the order of their names."""
    remedy = "correct the order in the robot's configuration; do not move it before"
    return _explained(about, Cause.ORDER, "joints and poses agree", remedy)


def tip(about: ArmHeard) -> Finding:
    """Judge whether poses are of the tool's tip."""
    remedy = "set the tool's tip offset in the robot's software (dVRK: the tool file), or use joints instead of poses"
    return _explained(about, Cause.TIP, "poses are the tip's", remedy)


def pose(about: ArmHeard) -> Finding:
    """Judge whether the pose in the arm's base is that of the joints."""
    known = about.explained
    if known is None:
        return Finding(None, "joints or poses did not come")
    if known.cause in (Cause.UNITS, Cause.ORDER, Cause.TIP):
        return Finding(None, f"cannot be told: see {known.cause.name.lower()}")
    remedy = (
        "choose the arm's model and instrument in the station's file, or look for an error in the robot's kinematics"
    )
    return Finding(known.cause is Cause.NONE, _off(known.off_m, known.off_rad), remedy)


def frames(about: ArmHeard) -> Finding:
    """Judge whether poses are in the station's world."""
    (at_s, T), (local_s, T_base_tip) = about.poses("measured_cp"), about.poses("local/measured_cp")
    if len(at_s) == 0 or len(local_s) == 0:
        return Finding(None, "poses did not come")
    if blocked := about.after("units"):
        return blocked
    some = np.unique(np.linspace(0, len(at_s) - 1, SAMPLES).astype(int))
    same = np.array([int(np.abs(local_s - at_s[k]).argmin()) for k in some])
    T, T_base_tip = T[some], T_base_tip[same]
    off_m, off_rad = apart(registered(about.station.arms[about.arm]) @ T_base_tip, T)
    if near(off_m, off_rad, FRAME_M, FRAME_RAD):
        return Finding(True, _off(off_m, off_rad))
    where = frame_of(about.station, about.arm, T_base_tip, T)
    found = f"{_off(off_m, off_rad)}; {f'they are in {where}' if where else 'in no frame that is known'}"
    remedy = "set the robot's base frame (dVRK: set_base_frame), or the arm's 'base' in the station's file"
    return Finding(False, found, remedy)


def ranges(about: ArmHeard) -> Finding:
    """Judge whether joints and jaws are within their ranges."""
    if blocked := about.after("units", "order"):
        return blocked
    model, seen = about.station.arms[about.arm].model, False
    for what in ("measured_js", "setpoint_js"):
        _, q = about.joints(what)
        seen = seen or len(q) > 0
        tolerance = RANGE_SHARE * (model.upper - model.lower)
        for place in np.argwhere((q < model.lower - tolerance) | (q > model.upper + tolerance))[:1]:
            joint, value = model.joints[place[1]], float(q[tuple(place)])
            bounds = f"{joint.shown(joint.lower)} to {joint.shown(joint.upper)}"
            found = f"{joint.name} of {what} is at {joint.shown(value)}, outside {bounds}"
            return Finding(False, found, "move it back at its console; check the zero of its encoder, and its model")
    jaw = about.streams.get(f"{jaw_topic(about.topics.dialect, about.topic)}/measured_js", [])
    for _, one in jaw:
        if one.position and not model.jaw.lower - JAW_RAD <= one.position[0] <= model.jaw.upper + JAW_RAD:
            found = f"the jaws are at {shown(one.position[0], 'rad')}"
            return Finding(False, found, "check the jaws' unit (rad) and the instrument in the station's file")
    return Finding(True, "all inside") if seen else Finding(None, "nothing came")


def speeds(about: ArmHeard) -> Finding:
    """Judge whether the joints' readings change no faster than a joint can move."""
    if blocked := about.after("stamps"):
        return blocked
    at_s, q = about.joints("measured_js")
    new = np.flatnonzero(np.diff(at_s, prepend=-np.inf) > 0)
    at_s, q = at_s[new], q[new]
    if len(q) < 3:
        return Finding(None, "too little came")
    model = about.station.arms[about.arm].model
    most = np.array([joint.max_speed for joint in model.joints])
    shares = np.abs(np.diff(q, axis=0)) / np.maximum(np.diff(at_s), 2e-3)[:, None] / most
    k, i = np.unravel_index(int(shares.argmax()), shares.shape)
    joint, share = model.joints[i], float(shares[k, i])
    found = f"{100 * share:.0f} % of the greatest of {joint.name}"
    remedy = "look for a loose cable of its encoder; do not move it before"
    return Finding(share <= SPEED_SHARE, found, remedy)


def following(about: ArmHeard) -> Finding:
    """Judge whether the joints follow their set-points as closely as the loop requires."""
    if blocked := about.after("finite", "stamps", "units", "order", "ranges", "speeds"):
        return blocked
    (at_s, q), (set_s, sent) = about.joints("measured_js"), about.joints("setpoint_js")
    settings = loop_settings(about.topics)
    arm = about.station.arms[about.arm]
    within = DrivenArm(arm.model, arm.limits).following(settings)
    first_s = set_s[0] + settings.lag_s if len(set_s) else np.inf
    late = [k for k in range(len(at_s)) if at_s[k] >= first_s]
    if not late:
        return Finding(None, "too little came")
    off = np.zeros(6)
    for k in late:
        recent = sent[(set_s >= at_s[k] - settings.lag_s) & (set_s <= at_s[k])]
        if len(recent):
            off = np.maximum(off, np.maximum(0.0, np.maximum(q[k] - recent.max(axis=0), recent.min(axis=0) - q[k])))
    worst = int((off / within).argmax())
    joint = arm.model.joints[worst]
    found = f"{joint.name} is off by {joint.shown(float(off[worst]), '.2f')}"
    remedy = "look for a collision, a motor without power, or an encoder that is off by this much; home the arm again"
    return Finding(bool((off <= within).all()), found, remedy)


def _explained(about: ArmHeard, cause: Cause, well: str, remedy: str) -> Finding:
    known = about.explained
    if known is None:
        return Finding(None, "joints or poses did not come, or are not numbers")
    if known.cause is cause:
        return Finding(False, known.detail, remedy)
    return Finding(True, well) if known.cause is not Cause.UNKNOWN else Finding(None, "cannot be told: see pose")


def _off(off_m: float, off_rad: float) -> str:
    return f"off by {shown(off_m, 'm')}, {shown(off_rad, 'rad')}"


MOTION = {
    "state": ("ENABLED, homed", state),
    "busy": ("not busy while at rest", busy),
    "finite": ("all are numbers", finite),
    "names": ("those of the dialect", names),
    "units": ("rad and m", units),
    "order": ("that of the names", order),
    "tip": (f"within {shown(POSE_M, 'm', 'g')}", tip),
    "pose": (f"within {shown(POSE_M, 'm', 'g')}, {shown(POSE_RAD, 'rad')}", pose),
    "frames": (f"in the world, within {shown(FRAME_M, 'm', 'g')}, {shown(FRAME_RAD, 'rad')}", frames),
    "ranges": ("inside", ranges),
    "speeds": (f"{100 * SPEED_SHARE:g} % or less", speeds),
    "following": (
        f"{shown(USUAL.following_rad, 'rad')} or {shown(USUAL.following_m, 'm', 'g')}, {USUAL.lag_s:g} s later",
        following,
    ),
}
"""Checks by name, in order: the expected result in words, and the test."""
