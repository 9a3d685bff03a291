"""MP4 files, encoded as H.264 frame by frame, so only one frame is in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import NotInstalled

Frame = Callable[[NDArray[np.uint8] | None], None]
"""Adds a frame (h, w, 3) RGB; None: repeats the last one."""


def require_encoder() -> None:
    """Raise NotInstalled unless videos can be encoded; ask before a long computation."""
    if find_spec("av") is None:
        raise NotInstalled("an MP4 video", "av", "lerobot")


@contextmanager
def mp4(
    draft: str | Path, size: tuple[int, int], fps: int, options: Mapping[str, str], mark: str = ""
) -> Iterator[Frame]:
    """Yield a function that adds a frame to an MP4 file, which is complete when the block ends.

    Args:
        draft: to write to.
        size: (height, width) in pixels; H.264 wants both even.
        fps: frames per second.
        options: of libx264.
        mark: kept as the file's comment.

    Raises:
        NotInstalled: the encoder is missing.
    """
    require_encoder()
    import av

    with av.open(str(draft), "w", format="mp4") as file:
        if mark:
            file.metadata["comment"] = mark
        stream = file.add_stream("libx264", rate=fps, options=dict(options))
        (stream.height, stream.width), stream.pix_fmt, stream.thread_count = size, "yuv420p", 1
        frame, number = None, 0

        def add(pixels: NDArray[np.uint8] | None) -> None:
            nonlocal frame, number
            if pixels is not None:
                frame = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(format="yuv420p")
            assert frame is not None, "the first frame repeats none"
            frame.pts, number = number, number + 1
            file.mux(stream.encode(frame))

        yield add
        file.mux(stream.encode())
