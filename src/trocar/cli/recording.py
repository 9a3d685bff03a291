"""``trocar recording``: what bags hold, and calibration recordings and images from them."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from typer import Argument, Option

from trocar.calibration.recording import MISDETECTION_RAD
from trocar.cli.group import Result
from trocar.cli.options import need
from trocar.cli.out_folder import check_out_folder, require_file
from trocar.cli.progress import waiting
from trocar.counting import counted
from trocar.errors import InvalidInput, InvalidValue

if TYPE_CHECKING:
    from trocar.bags.images import CameraFiles
    from trocar.bags.joints import Choice, Imported
    from trocar.bags.reader import Bag

BagPath = Annotated[
    Path, Argument(metavar="BAG", help="A .bag (ROS 1), the folder of a ROS 2 bag, its .db3, or an .mcap.")
]


def show(bag: BagPath) -> Result:
    """Print what a bag holds: topics, kinds and numbers of messages, mean rates, and the arms and cameras in it."""
    need("bags")
    from trocar.bags.images import cameras_in
    from trocar.bags.joints import arms_in
    from trocar.bags.reader import open_bag

    with open_bag(bag) as opened:
        topics = opened.topics.values()
        arms, cameras = arms_in(opened), cameras_in(opened)
    rates = {topic.name: topic.messages / opened.duration_s if opened.duration_s else None for topic in topics}
    summary = {
        "bag": str(bag),
        "ros": opened.ros,
        "duration_s": opened.duration_s,
        "topics": {t.name: {"kind": t.kind, "messages": t.messages, "rate_hz": rates[t.name]} for t in topics},
        "arms": arms,
        "cameras": cameras,
    }
    name_width, kind_width = (
        max(len(text) for text in texts) for texts in zip(*((t.name, t.kind) for t in topics), strict=True)
    )
    lines = [
        f"{bag}: {counted(len(topics), 'topic')} of ROS {opened.ros} over {opened.duration_s:.1f} s",
        *(
            f"  {t.name:{name_width}}  {t.kind or 'mixed':{kind_width}}  {t.messages:8d}  {_rate(rates[t.name])}"
            for t in topics
        ),
        f"arms with commands and measurements: {', '.join(arms) or 'none'}; cameras: {', '.join(cameras) or 'none'}",
    ]
    return Result(summary, lines)


def _rate(rate_hz: float | None) -> str:
    return "" if rate_hz is None else f"{rate_hz:.1f} Hz"


def import_bag(
    bag: BagPath,
    *,
    out: Annotated[
        Path | None, Option(metavar="FILE.npz", help="Write the recording of an arm here, for trocar calibrate.")
    ] = None,
    namespace: Annotated[
        str,
        Option(metavar="/PSM1", help="Of the arm's topics.", show_default="that of a topic given, or the only arm's"),
    ] = "",
    commanded: Annotated[
        str,
        Option(
            metavar="TOPIC",
            help="JointState with the commands.",
            show_default="setpoint_js of the namespace, else servo_jp or move_jp",
        ),
    ] = "",
    measured: Annotated[
        str,
        Option(metavar="TOPIC", help="JointState with the measurements.", show_default="measured_js of the namespace"),
    ] = "",
    joints: Annotated[
        str,
        Option(
            metavar="A,B,C,D,E,F", help="Names of the six joints in the messages, q1 to q6.", show_default="the dVRK's"
        ),
    ] = "",
    settled: Annotated[
        float, Option(metavar="S", help="Count only measurements for which the command has stood still this long, s.")
    ] = 0.0,
    images: Annotated[
        Path | None, Option(metavar="DIR", help="Write the cameras' images here, a folder for each topic.")
    ] = None,
    camera: Annotated[
        list[str] | None,
        Option(metavar="TOPIC", help="Images of this topic alone; several times for more.", show_default="all"),
    ] = None,
) -> Result:
    """Write an arm's joints in a bag as a recording for cable models, and the cameras' images as files.

    Times are the stamps of the headers, after the bag's beginning; messages with a stamp of 0 are not valid and left
    out. Beside each measurement is the last command before it; commands that came and went between two measurements
    are rows of their own without a measurement, since a cable remembers them.
    """
    need("bags")
    from trocar.bags.images import write_images
    from trocar.bags.joints import choose, read_recording
    from trocar.bags.reader import open_bag

    if out is None and images is None:
        remedy = "give --out, --images or both; trocar recording show lists the topics"
        raise InvalidInput("the import", "has nothing to write", remedy)
    of_joints = {
        "--namespace": namespace,
        "--commanded": commanded,
        "--measured": measured,
        "--joints": joints,
        "--settled": settled,
    }
    for needed, missing, flags in (
        ("--out", out is None, of_joints),
        ("--images", images is None, {"--camera": camera}),
    ):
        for flag, value in flags.items():
            if value and missing:
                raise InvalidInput(flag, f"has no effect without {needed}", f"drop {flag}, or add {needed}")
    if not 0 <= settled < inf:
        raise InvalidValue("--settled", settled, "give seconds, 0 or more")
    if out is not None:
        require_file("--out", out, "recording", (".npz",), [bag])
    check_out_folder(images, {}, option="--images")
    summary: dict[str, Any] = {"bag": str(bag)}
    lines: list[str] = []
    with open_bag(bag) as opened:
        if out is not None:
            choice = choose(opened, namespace, commanded, measured)
            with waiting(f"reading {choice.commanded} and {choice.measured}"):
                order = tuple(joints.split(",")) if joints else ()
                found = read_recording(opened, choice, order, settled)
            found.recording.save(out)
            summary["recording"] = _recording_summary(out, opened, choice, found)
            lines += _recording_lines(out, choice, found)
        if images is not None:
            with waiting("writing images"):
                written = write_images(opened, images, camera or [])
            summary["images"] = [_images_summary(one) for one in written]
            lines += [line for one in written for line in _images_lines(one)]
    return Result(summary, lines)


def _recording_summary(out: Path, bag: Bag, choice: Choice, found: Imported) -> dict[str, Any]:
    series = {choice.commanded: found.commanded, choice.measured: found.measured}
    return {
        "file": str(out),
        "commanded": choice.commanded,
        "measured": choice.measured,
        "encoders": choice.encoders,
        "start_ns": bag.start_ns,
        "rows": len(found.recording),
        "valid": int(found.recording.valid.sum()),
        "before_the_first_command": found.early,
        "without_measurement": found.between,
        "moving": found.moving,
        "left_out": {
            name: {"unstamped": one.unstamped, "empty": one.empty, "unfit": one.unfit} for name, one in series.items()
        },
        "out_of_order": {name: one.late for name, one in series.items()},
        "unnamed": {name: one.unnamed for name, one in series.items()},
    }


def _recording_lines(out: Path, choice: Choice, found: Imported) -> list[str]:
    """Return sentences about a recording: what it contains, and all its irregularities."""
    rows = len(found.recording)
    lasts_s = found.recording.t_s[-1] - found.recording.t_s[0]
    lines = [
        f"{out}: {rows} rows over {lasts_s:.1f} s, commanded by {choice.commanded}, measured by {choice.measured}",
        "beside each measurement is the last command before it"
        + (f"; {counted(found.between, 'row')} of commands in between have none" if found.between else ""),
    ]
    for name, one in ((choice.commanded, found.commanded), (choice.measured, found.measured)):
        notes = {
            "with a stamp of 0 (not valid), left out": one.unstamped,
            "without finite positions, left out": one.empty,
            "of other joints, or without a position for each name, left out": one.unfit,
            "with an earlier stamp than the one before, put in order": one.late,
            "without names of joints, taken as q1 to q6": one.unnamed,
        }
        lines += [f"{name}: {counted(count, 'message')} {words}" for words, count in notes.items() if count]
    if found.early:
        lines.append(f"{counted(found.early, 'measurement')} before the first command, left out")
    if found.moving:
        lines.append(f"{counted(found.moving, 'measurement')} during or too soon after a motion, marked as not valid")
    far = int(np.sum(~found.recording.valid)) - found.between - found.moving
    if far:
        words = f"with a wrist angle {MISDETECTION_RAD:g} rad or more from its command, marked as not valid"
        lines.append(f"{counted(far, 'measurement')} {words}")
    if choice.encoders:
        lines.append(
            "warning: by their topic, the measurements are those of the arm's encoders, which do not see its cables: a "
            "cable model needs joints measured by something else (--measured TOPIC)"
        )
    return lines


def _images_summary(written: CameraFiles) -> dict[str, Any]:
    return {**vars(written), "list": str(written.list), "lens": written.lens is not None}


def _images_lines(written: CameraFiles) -> list[str]:
    missing = "without a lens: no camera info of the images' size and of Brown's distortion belongs to it"
    lens = "with its lens" if written.lens else missing
    lines = [f"{written.list.parent}: {counted(written.images, 'image')} of {written.topic}, {lens}"]
    if written.unstamped:
        lines.append(f"{written.topic}: {counted(written.unstamped, 'image')} with a stamp of 0, left out")
    if written.damaged:
        lines.append(f"{written.topic}: {counted(written.damaged, 'image')} of other bytes than it claims, left out")
    for encoding, count in written.unknown.items():
        lines.append(f"{written.topic}: {counted(count, 'image')} in {encoding!r}, which cannot be read, left out")
    return lines
