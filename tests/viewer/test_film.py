"""Films: colours of all their pictures, sizes that encoders do not take, and the encoder that is missing."""

from __future__ import annotations

import io
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.viewer import film

_PAPER, _RED, _BLUE = (250, 248, 240), (220, 30, 20), (0, 114, 178)


def _picture(colour: tuple[int, int, int], size: tuple[int, int] = (41, 33)) -> bytes:
    image = Image.new("RGB", size, _PAPER)
    image.paste(colour, (10, 10, 20, 20))
    image.save(buffer := io.BytesIO(), format="PNG")
    return buffer.getvalue()


def test_colours_that_come_later_are_in_the_palette_of_a_gif(tmp_path: Path) -> None:
    path = film.write_film(tmp_path / "film.gif", [_picture(_BLUE)] * 6 + [_picture(_RED)] * 6, 1.2)
    with Image.open(path) as moving:
        for frame, colour in ((0, _BLUE), (moving.n_frames - 1, _RED)):  # equal ones are one
            moving.seek(frame)
            pixels = np.asarray(moving.convert("RGB")).astype(int)
            assert np.abs(pixels[15, 15] - colour).max() < 8
            assert np.abs(pixels[0, 0] - _PAPER).max() < 8


@pytest.mark.skipif(film.encoder() is None, reason="neither ffmpeg nor imageio-ffmpeg is installed")
def test_an_odd_size_is_filled_with_the_background(tmp_path: Path) -> None:
    path = film.write_film(tmp_path / "film.mp4", [_picture(_BLUE)] * 10, 1.0)
    first = ["-frames:v", "1", "-f", "image2pipe", "-c:v", "png", "-"]
    command = [str(film.encoder()), "-loglevel", "error", "-i", str(path), *first]
    done = subprocess.run(command, capture_output=True, check=True)
    pixels = np.asarray(Image.open(io.BytesIO(done.stdout)).convert("RGB")).astype(int)
    assert pixels.shape == (34, 42, 3)
    assert np.abs(pixels[:, -1] - _PAPER).max() < 12
    assert np.abs(pixels[-1] - _PAPER).max() < 12


def test_a_missing_encoder_is_named_with_the_way_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "encoder", lambda: None)
    with pytest.raises(OutputError, match=r"pip install imageio-ffmpeg.*\.gif"):
        film.write_film(tmp_path / "film.mp4", [_picture(_BLUE)], 1.0)
    assert not list(tmp_path.iterdir())
