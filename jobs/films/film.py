"""Pictures with a caption as a film: a GIF, or an MP4 where there is an ffmpeg."""

from __future__ import annotations

import importlib
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from jobs.experiment.yaml_source import SpecError

_LEAST_WIDTH = 240
"""In pixels, so that the caption has room; smaller pictures are enlarged."""
_FONT_SIZE, _LINE_HEIGHT, _MARGIN = 12, 17, 5
_DARK, _LIGHT = (54, 60, 70), (245, 245, 245)
_GIF_LAST_SECONDS = 1.5
"""How long the last picture of a GIF stays before the first comes again."""


@dataclass(frozen=True)
class Caption:
    """Two lines below a picture, each with something at the left and at the right."""

    left: tuple[str, str]
    right: tuple[str, str]


def check_output(path: Path) -> None:
    """See whether a film can be written there, before anything long begins.

    Raises
    ------
    SpecError
        If it cannot.
    """
    if path.suffix not in (".gif", ".mp4"):
        message = f"--output: found {str(path)!r}, expected a name that ends in .gif or .mp4"
        raise SpecError(message)
    if not path.parent.is_dir():
        message = f"--output: found {str(path)!r}, expected a folder that exists: there is no {str(path.parent)!r}"
        raise SpecError(message)
    if path.is_dir():
        message = f"--output: found the folder {str(path)!r}, expected the name of a file"
        raise SpecError(message)
    if path.suffix == ".mp4":
        _ffmpeg()


def captioned(image: NDArray[np.uint8], caption: Caption) -> Image.Image:
    """The picture ``uint8[height, width, 3]``, enlarged if it is small, with a caption below."""
    enlarged = image.repeat(scale := -(-_LEAST_WIDTH // image.shape[1]), axis=0).repeat(scale, axis=1)
    height, width = enlarged.shape[:2]
    # H.264 as every player knows it wants an even number of pixels.
    whole = Image.new("RGB", (width + width % 2, height + height % 2 + 2 * _LINE_HEIGHT + 2 * _MARGIN), _DARK)
    whole.paste(Image.fromarray(enlarged))
    draw, font = ImageDraw.Draw(whole), _font()
    for line, (left, right) in enumerate(zip(caption.left, caption.right, strict=True)):
        y = height + _MARGIN + line * _LINE_HEIGHT
        room = whole.width - 3 * _MARGIN - font.getlength(right)
        draw.text((_MARGIN, y), _shortened(left, room), fill=_LIGHT, font=font)
        draw.text((whole.width - _MARGIN, y), right, fill=_LIGHT, font=font, anchor="ra")
    return whole


def _shortened(text: str, room: float) -> str:
    """As much of a text as has room."""
    if _font().getlength(text) <= room:
        return text
    while text and _font().getlength(f"{text}…") > room:
        text = text[:-1]
    return f"{text}…"


@cache
def _font() -> ImageFont.FreeTypeFont:
    """The font of the figures, which matplotlib brings along."""
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), _FONT_SIZE)


def write_film(path: Path, pictures: Iterator[Image.Image], num_pictures: int, fps: float) -> None:
    """Write pictures of one size; the file is seen whole or not at all.

    Raises
    ------
    SpecError
        If ffmpeg cannot write it.
    """
    unfinished = path.with_name(f".{path.stem}.unfinished{path.suffix}")
    try:
        if path.suffix == ".gif":
            _write_gif(unfinished, pictures, num_pictures, fps)
        else:
            _write_mp4(unfinished, pictures, fps)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def _write_gif(path: Path, pictures: Iterator[Image.Image], num_pictures: int, fps: float) -> None:
    seconds = [1.0 / fps] * (num_pictures - 1) + [max(_GIF_LAST_SECONDS, 1.0 / fps)]
    # A GIF counts hundredths of a second.
    durations = [10 * round(100 * second) for second in seconds]
    first = next(pictures)
    first.save(path, "GIF", save_all=True, append_images=pictures, duration=durations, loop=0)


def _write_mp4(path: Path, pictures: Iterator[Image.Image], fps: float) -> None:
    first = next(pictures)
    pictures = chain([first], pictures)
    command = _mp4_command(path, first.size, fps)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None  # noqa: S101 - it is a pipe
        assert process.stderr is not None  # noqa: S101 - so is this
        with suppress(BrokenPipeError):  # where it has ended already, it says why
            for picture in pictures:
                process.stdin.write(picture.tobytes())
            process.stdin.close()
        complaint = process.stderr.read().decode(errors="replace").strip()
    if process.returncode:
        message = f"--output: ffmpeg could not write {path.name}: {complaint}"
        raise SpecError(message)


def _mp4_command(path: Path, size: tuple[int, int], fps: float) -> Sequence[str]:
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", str(fps), "-i", "-"]
    encoded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    return [_ffmpeg(), "-y", "-loglevel", "error", *raw, *encoded, str(path)]


def _ffmpeg() -> str:
    """The program: that of imageio-ffmpeg, else what is installed."""
    try:
        found: str | None = importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        found = shutil.which("ffmpeg")
    if found is None:
        message = "--output: found no ffmpeg for an .mp4, expected that of `pip install imageio-ffmpeg`, or a .gif"
        raise SpecError(message)
    return found
