"""Pictures written as a film: GIF by Pillow, MP4 by ffmpeg, the machine's or that of imageio-ffmpeg."""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from pm3dof_pin.exceptions import InvalidValueError, OutputError
from pm3dof_pin.files import write_atomically

_ENCODER = "-c:v libx264 -pix_fmt yuv420p -movflags +faststart -vf pad=ceil(iw/2)*2:ceil(ih/2)*2:color={} -f mp4"
_SAMPLES = 8  # pictures whose colours make the palette of a GIF


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
    samples = images[:: -(-len(images) // _SAMPLES)]
    width, height = images[0].size
    sheet = Image.new("RGB", (width, height * len(samples)))
    for row, sample in enumerate(samples):
        sheet.paste(sample, (0, row * height))
    palette = sheet.quantize(256, method=Image.Quantize.MAXCOVERAGE)  # small parts keep their colours
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    pace = round(1000.0 * duration / len(frames))
    frames[0].save(file, format="GIF", save_all=True, append_images=frames[1:], duration=pace, loop=0)


def encoder() -> str | None:
    """Return the path of ffmpeg, or None."""
    if found := shutil.which("ffmpeg"):
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # there is none for this platform
        return None


def _write_mp4(file: Path, pictures: Sequence[bytes], duration: float, path: Path) -> None:
    from PIL import Image

    if (program := encoder()) is None:
        way_out = "pip install imageio-ffmpeg, or a name that ends in .gif"
        raise OutputError(path, f"neither ffmpeg nor imageio-ffmpeg is installed, which write MP4: {way_out}")
    corner = Image.open(io.BytesIO(pictures[0])).convert("RGB").crop((0, 0, 1, 1))
    background = f"0x{corner.tobytes().hex()}"  # of the line that makes an odd size even
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", f"{len(pictures) / duration:g}", "-i", "-"]
    command = [program, "-loglevel", "error", "-y", *source, *_ENCODER.format(background).split(), str(file)]
    done = subprocess.run(command, input=b"".join(pictures), capture_output=True, check=False)
    if done.returncode:
        raise OutputError(path, f"ffmpeg: {done.stderr.decode(errors='replace').strip()}")
