"""Picture formats, and removal of an earlier run's pictures, which must not remain next to new data."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pm3dof_pin.cli.output import message

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# pixels at 300 dpi, vector graphics, or pixels on a dark ground
PictureFormat = StrEnum("PictureFormat", {"png": "png", "pdf": "pdf", "svg": "svg", "dark": "dark.png"})


Formats = Annotated[
    list[PictureFormat] | None,
    typer.Option("--format", help="Picture format; may be repeated (png)."),
]


def save(figure: Figure, path: Path, formats: Iterable[PictureFormat] | None) -> list[Path]:
    """Write a picture in the formats of `--format`; the suffix of the path is ignored."""
    from pm3dof_pin.figures.style import save_pictures  # it loads matplotlib

    command = shlex.join(["pm3dof", *sys.argv[1:]])
    return save_pictures(figure, path, [entry.value for entry in formats or (PictureFormat.png,)], command)


def remove_former(folder: Path, names: str, written: Iterable[Path]) -> None:
    """Remove pictures of an earlier run that this one has not written, and report them.

    `names` is a regular expression matching every name, without suffix, that the job's pictures may have.
    """
    if not folder.is_dir():
        return
    kept = {file.name for file in written}
    suffixes = "|".join(PictureFormat)
    former = [file for file in sorted(folder.iterdir()) if re.fullmatch(rf"(?:{names})\.(?:{suffixes})", file.name)]
    removed = [file for file in former if file.name not in kept]
    for file in removed:
        file.unlink()
    if removed:
        message(f"removed from {folder}, left by an earlier run: {', '.join(f.name for f in removed)}")
