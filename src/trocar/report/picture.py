"""A picture and its caption."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from trocar.files.output import PICTURE, make_folder, mark_of, writing


@dataclass(frozen=True)
class Picture:
    """A picture for a page.

    Attributes:
        path: of its file.
        alt: what it shows, for those who do not see it.
        caption: below it.
    """

    path: Path
    alt: str
    caption: str


def write_png(path: str | Path, image: Image.Image | NDArray[np.uint8]) -> Path:
    """Write a camera's picture as a PNG of 256 colours, a third of the size of a full one, and return its path."""
    image = image if isinstance(image, Image.Image) else Image.fromarray(image)
    path, mark = Path(path), PngInfo()
    mark.add_text("Software", mark_of(PICTURE))
    make_folder(path.parent)
    with writing(path, PICTURE) as draft:
        image.convert("RGB").quantize(256).save(draft, optimize=True, pnginfo=mark)
    return path
