"""Checks of what comes over the wire from an arm: topics, types, rates, clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trocar.crtk.convert import seconds
from trocar.crtk.heard_arm import ArmHeard, Finding
from trocar.crtk.listening import Message, heard_by, motion_prefixes
from trocar.crtk.messages import ros_name

RATE_HZ = 50.0
"""A loop of 100 Hz needs at least every other reading."""
GAP_S, JITTER_S, LATENCY_S = 0.1, 0.02, 0.05
CLOCK_S, AHEAD_S = 1.0, 0.01
"""A stamp is wrong if its message comes ``CLOCK_S`` later (no robot's network is so slow), or ``AHEAD_S`` earlier."""
PAUSE_S, SEEN_SHARE = 0.03, 0.5
"""Arrival times are unknown if other programs hold the listener up for longer, or if it finds less than this share of a
topic's messages at once."""


def topics(about: ArmHeard) -> Finding:
    """Judge whether somebody publishes each topic."""
    there = {one.topic for one in about.heard.endpoints if one.publishes}
    missing = [topic for topic, one in about.wanted.items() if one.needed and topic not in there]
    needed = sum(one.needed for one in about.wanted.values())
    if not missing:
        return Finding(True, f"{needed} of {needed}")
    others = sorted({topic.removesuffix("/measured_js") for topic in there if topic.endswith("/measured_js")})
    arms = [one for one in others if not one.endswith("/jaw")]
    hint = f"arms are heard as {', '.join(arms)}: name yours in [crtk.arms]" if arms else "no arm is heard at all"
    remedy = f"{hint}; check that the robot runs, the interface, and the domain or the master"
    return Finding(False, f"{needed - len(missing)} of {needed}: no {', '.join(missing)}", remedy)


def types(about: ArmHeard) -> Finding:
    """Judge whether topics have the types of their dialect, commands included."""
    right = {topic: ros_name(one.kind) for topic, one in about.wanted.items()}
    right_in = {topic: ros_name(kind) for topic, kind in heard_by(about.arm, about.topics).items()}
    wrong = sorted(
        {
            f"{one.topic} is {one.kind}, not {known[one.topic]}"
            for one in about.heard.endpoints
            for known in (right if one.publishes else right_in,)
            if one.topic in known and one.kind not in ("", known[one.topic])
        }
    )
    remedy = (
        "set 'dialect' of [crtk] to the robot's generation (crtk-1.0 before CRTK 1.1, raven), or update its software"
    )
    return Finding(not wrong, "; ".join(wrong) if wrong else "as they should be", remedy)


def publishers(about: ArmHeard) -> Finding:
    """Judge whether each topic has one publisher."""
    found: dict[str, list[str]] = {}
    for one in about.heard.endpoints:
        if one.publishes and one.topic in about.wanted:
            found.setdefault(one.topic, []).append(str(one.client))
    several = {topic: clients for topic, clients in found.items() if len(clients) > 1}
    if not several:
        return Finding(True, "one each")
    topic, clients = next(iter(several.items()))
    who = f"{len(several)} topics have several, {topic} those of {' and '.join(sorted(set(clients)))}"
    return Finding(False, who, "end all but one: two robots, or two consoles, have this arm's namespace in this domain")


def commands(about: ArmHeard) -> Finding:
    """Judge whether the arm takes the commands that drive it."""
    there = {one.topic for one in about.heard.endpoints if not one.publishes}
    wanted = heard_by(about.arm, about.topics)
    missing = [topic for topic in wanted if topic not in there]
    found = f"{len(wanted) - len(missing)} of {len(wanted)}"
    remedy = "start the part of the robot's software that takes commands, or set 'command' of [crtk] to what it takes"
    return Finding(not missing, f"{found}: nobody takes {', '.join(missing)}" if missing else found, remedy)


def commanders(about: ArmHeard) -> Finding:
    """Judge whether two programs are ready to move the arm."""
    begins = motion_prefixes(about.arm, about.topics)
    clients = {one.client for one in about.heard.endpoints if one.publishes and one.topic.startswith(begins)}
    who = " and ".join(sorted(map(str, clients))) or "nobody"
    return Finding(len(clients) < 2, who, "end all but one of them before anything moves")


def data(about: ArmHeard) -> Finding:
    """Judge whether something came on each topic."""
    silent = [topic for topic, one in about.wanted.items() if one.needed and not about.heard.messages[topic]]
    if not silent:
        return Finding(True, "on each topic")
    remedy = "check that the arm is powered, that the types agree, and that a firewall lets data pass"
    return Finding(False, f"nothing on {', '.join(silent)}", remedy)


def rate(about: ArmHeard) -> Finding:
    """Judge the rate of the slowest topic."""
    rates = {
        topic: (len(messages) - 1) / max(messages[-1][0] - messages[0][0], 1e-6)
        for topic, messages in about.come.items()
    }
    if not rates:
        return Finding(None, "nothing came")
    slowest = min(rates, key=lambda topic: rates[topic])
    remedy = "raise the rate at which the robot publishes (dVRK: its ROS bridge's period, -p 0.01)"
    return Finding(rates[slowest] >= RATE_HZ, f"{rates[slowest]:.1f} Hz of {slowest}", remedy)


def stamps(about: ArmHeard) -> Finding:
    """Judge whether stamps are valid and increase."""
    if not about.streams:
        return Finding(None, "nothing came")
    for topic, messages in about.streams.items():
        at = np.array([seconds(message.header.stamp) for _, message in messages])
        if (at == 0).any():
            remedy = "the robot says that its data are not valid: power, enable and home it"
            return Finding(False, f"{int((at == 0).sum())} of {len(at)} of {topic} are 0", remedy)
        if (np.diff(at) < 0).any():
            return Finding(False, f"those of {topic} go back", "let one program with one clock publish it")
        if (share := float((np.diff(at) > 0).mean())) < 0.9:
            remedy = "the robot sends old data again: restart its driver, and do not move it before"
            return Finding(False, f"{100 * share:.0f} % of {topic} are newer than the one before", remedy)
    return Finding(True, "all go on")


def gaps(about: ArmHeard) -> Finding:
    """Judge the longest time without a message, until the end of listening."""
    if busy := _busy(about) or about.after("rate"):
        return busy
    silent_s = {topic: about.heard.end_s - messages[-1][0] for topic, messages in about.streams.items()}
    first = max(silent_s, key=lambda topic: silent_s[topic])
    if silent_s[first] > GAP_S:
        found = f"nothing more of {first} in the last {1e3 * silent_s[first]:.0f} ms"
        return Finding(False, found, "look whether the robot's software still runs, and restart it before it moves")
    longest = {topic: _longest_gap_s(messages, about.heard.blind_s) for topic, messages in about.streams.items()}
    worst = max(longest, key=lambda topic: longest[topic])
    found = f"{1e3 * longest[worst]:.0f} ms of {worst}"
    return Finding(longest[worst] <= GAP_S, found, "use a cable instead of wireless, and relieve the robot's PC")


def clock(about: ArmHeard) -> Finding:
    """Judge whether the robot's clock agrees with this machine's."""
    if blocked := about.after("stamps") or _unseen(about):
        return blocked
    early_s = min(float(ages.min()) for ages in about.ages.values())
    found = f"messages come {abs(early_s):.3f} s {'after' if early_s >= 0 else 'before'} their stamps"
    if -AHEAD_S > early_s >= -AHEAD_S - about.heard.pause_s and (busy := _busy(about)):
        return busy  # a pause after the doctor read its clock makes messages seem that early
    well = -AHEAD_S <= early_s <= CLOCK_S
    return Finding(well, found, "let both machines' clocks agree: run chrony (NTP) on both, or ROS with wall time")


def latency(about: ArmHeard) -> Finding:
    """Judge how long after its stamp a message comes."""
    if busy := _busy(about) or about.after("stamps", "clock"):
        return busy
    usual_s = {topic: float(np.median(ages)) for topic, ages in about.ages.items()}
    worst = max(usual_s, key=lambda topic: usual_s[topic])
    remedy = (
        "look for queues and wireless links on the way, and compare the clocks (chronyc tracking): one way cannot tell"
    )
    return Finding(usual_s[worst] <= LATENCY_S, f"{1e3 * usual_s[worst]:.1f} ms of {worst}", remedy)


def jitter(about: ArmHeard) -> Finding:
    """Judge how regularly messages come."""
    if busy := _busy(about) or about.after("stamps"):
        return busy
    spread_s = {topic: float(np.percentile(ages, 95) - ages.min()) for topic, ages in about.ages.items()}
    worst = max(spread_s, key=lambda topic: spread_s[topic])
    found = f"{1e3 * spread_s[worst]:.1f} ms of {worst}"
    return Finding(spread_s[worst] <= JITTER_S, found, "use a cable instead of wireless, and relieve the robot's PC")


def _longest_gap_s(messages: Sequence[Message], blind_s: Mapping[float, float]) -> float:
    """Return the longest time between two messages in which certainly none came."""
    at_s = np.array([at_s for at_s, _ in messages])
    since_s = at_s - [blind_s.get(one, 0.0) for one in at_s.tolist()]
    return float((since_s[1:] - at_s[:-1]).max())


def _unseen(about: ArmHeard) -> Finding | None:
    """Return why arrival times are unknown, or None."""
    if not about.streams:
        return Finding(None, "nothing came")
    if any(len(about.ages[topic]) < SEEN_SHARE * len(messages) for topic, messages in about.streams.items()):
        return Finding(None, "this machine is too slow: the doctor itself found most messages late")
    return None


def _busy(about: ArmHeard) -> Finding | None:
    """Return why times cannot be judged, or None."""
    if about.heard.pause_s > PAUSE_S:
        held_up = f"the doctor itself was held up for {1e3 * about.heard.pause_s:.0f} ms"
        return Finding(None, f"this machine is busy: {held_up}")
    return _unseen(about)


WIRE = {
    "topics": ("all are published", topics),
    "types": ("those of the dialect", types),
    "publishers": ("one for each topic", publishers),
    "commands": ("all are taken", commands),
    "commanders": ("one program at most", commanders),
    "data": ("something on each topic", data),
    "rate": (f"{RATE_HZ:g} Hz or more", rate),
    "stamps": ("valid, each newer than the one before", stamps),
    "gaps": (f"{1e3 * GAP_S:g} ms or less", gaps),
    "clock": (f"{-AHEAD_S:g} to {CLOCK_S:g} s after", clock),
    "latency": (f"{1e3 * LATENCY_S:g} ms or less", latency),
    "jitter": (f"95 % within {1e3 * JITTER_S:g} ms", jitter),
}
"""Checks by name, in order: the expected result in words, and the test."""
