"""Pictures written as a film: GIF by Pillow, MP4 by ffmpeg."""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from pm3dof_pin.exceptions import InvalidValueError, OutputError
from pm3dof_pin.files import write_atomically

_ENCODER = "-c:v libx264 -pix_fmt yuv420p -movflags +faststart -vf pad=ceil(iw/2)*2:ceil(ih/2)*2 -f mp4"


def write_film(path: Path, pictures: Sequence[bytes], duration: float) -> Path:
    """Write pictures (PNG), shown one after the other during a time [s], as GIF or MP4, and return the path.

    Raises:
        InvalidValueError: the file is to be neither a GIF nor an MP4.
        OutputError: the file cannot be written, or there is no ffmpeg for an MP4; no partial file is left.
    """
    kind = path.suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise InvalidValueError("path", str(path), "a film that ends in .gif or .mp4")
    with write_atomically(path) as temporary:
        if kind == ".gif":
            _write_gif(temporary, pictures, duration)
        else:
            _write_mp4(temporary, pictures, duration, path)
    return path


def _write_gif(file: Path, pictures: Sequence[bytes], duration: float) -> None:
    from PIL import Image

    images = [Image.open(io.BytesIO(png)).convert("RGB") for png in pictures]
    palette = images[0].quantize(256, method=Image.Quantize.MAXCOVERAGE)  # small parts keep their colours
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    pace = round(1000.0 * duration / len(frames))
    frames[0].save(file, format="GIF", save_all=True, append_images=frames[1:], duration=pace, loop=0)


def _write_mp4(file: Path, pictures: Sequence[bytes], duration: float, path: Path) -> None:
    encoder = shutil.which("ffmpeg")
    if encoder is None:
        raise OutputError(path, "ffmpeg is not installed, which writes MP4; a name ending in .gif needs none")
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", f"{len(pictures) / duration:g}", "-i", "-"]
    command = [encoder, "-loglevel", "error", "-y", *source, *_ENCODER.split(), str(file)]
    done = subprocess.run(command, input=b"".join(pictures), capture_output=True, check=False)
    if done.returncode:
        raise OutputError(path, f"ffmpeg: {done.stderr.decode(errors='replace').strip()}")
