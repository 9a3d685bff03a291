"""How well two eyes find fragments and grippers: python benchmarks/bench_stereo.py --scenes 200.

Each scene has six random fragments in their region and both arms anywhere over the surface, jaws open at random, under
the stereo pair of the station raven-pair with noise, shadows and wet spots. Errors are relative to the simulator's
truth: a fragment's centre of volume, and the pose of a gripper's controlled point. A fragment is visible if each eye
sees at least half of its outline (pixels of an exact rendering, divided by the area of the projected hull); a gripper
is visible if each eye sees at least ``--mark-share`` of the disc of at least three marks. A detection counts for the
nearest fragment within 6 mm, once; other detections are false. Times are processor times.
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np
from stereo_scenes import CAMERA, RIG, STATION, T_WORLD_TABLE, Shown, scenes

from trocar.perception.image import StereoImage, StereoWindow, Window
from trocar.tasks.debridement.perception.gripper import SeenGripper
from trocar.tasks.debridement.perception.stereo_view import StereoView

NEAR_M = 6e-3
VISIBLE = 0.5
T_WORLD_CAMERA = CAMERA.T_world_camera


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--backdrop", default="plain")
    parser.add_argument("--mark-share", type=float, default=0.6)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    fragments, grippers = Fragments(), Grippers(given.mark_share)
    for shown in scenes(given.scenes, given.seed, given.backdrop):
        fragments.add(shown)
        grippers.add(shown)
    print(f"{given.scenes} scenes, seed {given.seed}, backdrop {given.backdrop}\n")
    print("| | measured | target |\n|---|---|---|")
    for row in fragments.rows() + grippers.rows():
        print("| " + " | ".join(row) + " |")


class Fragments:
    """Results for fragments."""

    def __init__(self) -> None:
        self.errors_m: list[float] = []
        self.along_m: list[np.ndarray] = []
        self.seconds: list[float] = []
        self.visible = self.missed = self.false = 0

    def add(self, shown: Shown) -> None:
        """Look at one scene."""
        begin = time.process_time()
        found = StereoView().fragments(shown.image, T_WORLD_CAMERA, T_WORLD_TABLE)
        self.seconds.append(time.process_time() - begin)
        names = list(shown.p_world_m)
        free = set(range(len(found)))
        apart = [(np.linalg.norm(f.p_world_m - shown.p_world_m[n]), k, n) for k, f in enumerate(found) for n in names]
        taken: dict[str, int] = {}
        for distance, k, name in sorted(apart, key=lambda pair: pair[0]):
            if distance <= NEAR_M and k in free and name not in taken:
                taken[name] = k
                free.remove(k)
        self.false += len(free)
        for name in names:
            if min(shown.visible[name]) < VISIBLE:
                continue
            self.visible += 1
            self.missed += name not in taken
            if name in taken:
                off = found[taken[name]].p_world_m - shown.p_world_m[name]
                self.errors_m.append(float(np.linalg.norm(off)))
                self.along_m.append(off)

    def rows(self) -> list[tuple[str, str, str]]:
        """Return the rows of the table: what, measured, target."""
        p50, p95 = 1e3 * np.percentile(self.errors_m, [50, 95])
        mean, sd = 1e3 * np.mean(self.along_m, 0), 1e3 * np.std(self.along_m, 0)
        return [
            ("fragment, error of the centre of volume p50 / p95, mm", f"{p50:.2f} / {p95:.2f}", "p95 1.5"),
            ("its mean on x y z, mm", " ".join(f"{v:.2f}" for v in mean), ""),
            ("its standard deviation on x y z, mm", " ".join(f"{v:.2f}" for v in sd), ""),
            (f"missed of {self.visible} visible", _share(self.missed, self.visible), "1 %"),
            ("false detections", str(self.false), "0"),
            ("time for a pair of whole pictures p50, ms", f"{1e3 * np.median(self.seconds):.0f}", "60"),
        ]


class Grippers:
    """Results for grippers."""

    def __init__(self, mark_share: float) -> None:
        self._least = mark_share
        self.off: list[tuple[float, float, float]] = []
        self.off_hidden: list[tuple[float, float, float]] = []
        self.seconds: list[float] = []
        self.visible = self.missed = self.hidden = 0

    def add(self, shown: Shown) -> None:
        """Look at one scene."""
        view = StereoView()
        for name, arm in STATION.models.items():
            window = view.gripper_window(shown.T_world_tip[name], T_WORLD_CAMERA, RIG, margin_m=5e-3)
            visible = np.count_nonzero(shown.marks[name].min(1) >= self._least) >= 3
            self.visible += visible
            self.hidden += not visible
            if window is None:
                self.missed += visible
                continue
            image = windowed(shown.image, window)
            begin = time.process_time()
            found = view.gripper(image, T_WORLD_CAMERA, arm)
            self.seconds.append(time.process_time() - begin)
            if found is None:
                self.missed += visible
            else:
                (self.off if visible else self.off_hidden).append(_off(found, shown, name))

    def rows(self) -> list[tuple[str, str, str]]:
        """Return the rows of the table: what, measured, target."""
        p50, p95 = np.percentile(self.off, [50, 95], axis=0)
        rows = [
            ("gripper, error of position p50 / p95, mm", f"{p50[0]:.2f} / {p95[0]:.2f}", ""),
            ("error of rotation p50 / p95, deg", f"{p50[1]:.2f} / {p95[1]:.2f}", ""),
            ("error of the opening p50 / p95, deg", f"{p50[2]:.2f} / {p95[2]:.2f}", ""),
            (f"refused of {self.visible} visible", _share(self.missed, self.visible), ""),
            ("time in windows p50, ms", f"{1e3 * np.median(self.seconds):.0f}", "10"),
            (f"found of {self.hidden} half hidden", str(len(self.off_hidden)), ""),
        ]
        if self.off_hidden:
            worst = np.percentile(self.off_hidden, [50, 95], axis=0)
            text = f"{worst[0][0]:.2f} / {worst[1][0]:.2f}, {worst[0][1]:.1f} / {worst[1][1]:.1f}"
            rows.append(("their errors p50 / p95, mm, deg", text, ""))
        return rows


def windowed(image: StereoImage, window: StereoWindow) -> StereoImage:
    """Return the part of a pair of pictures that a window reads out."""

    def part(picture: np.ndarray, one: Window) -> np.ndarray:
        (u, v), (wide, high) = one.corner_px, one.size_px
        return np.ascontiguousarray(picture[v : v + high, u : u + wide])

    return StereoImage(
        part(image.left, window.left), part(image.right, window.right), window.of(image.rig), image.time_s
    )


def _off(found: SeenGripper, shown: Shown, name: str) -> tuple[float, float, float]:
    """Return the errors of position in mm, of rotation and opening in deg."""
    off = shown.T_world_tip[name].inverse() @ found.T_world_tip
    turned = np.degrees(np.linalg.norm(off.rotation.log()))
    opened = abs(np.degrees(found.jaw_rad - shown.jaw_rad[name]))
    return 1e3 * float(np.linalg.norm(off.translation_m)), float(turned), float(opened)


def _share(count: int, of: int) -> str:
    return f"{count} ({count / max(of, 1):.1%})"


if __name__ == "__main__":
    main()
