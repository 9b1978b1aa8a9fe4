"""The style of all pictures, and writing them to files."""

from __future__ import annotations

import io
import itertools
import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator

import pm3dof_pin
from pm3dof_pin.figures.dark import darkened
from pm3dof_pin.figures.labels import plain
from pm3dof_pin.figures.png import png
from pm3dof_pin.files import write_atomically
from pm3dof_pin.typing import Array

COLORMAP = "viridis"  # perceptually uniform: readable without colour vision and in greyscale
DPI = 300
ONE_COLUMN, TWO_COLUMNS = 88.0 / 25.4, 180.0 / 25.4  # widths of pictures in journals: 88 and 180 mm [inch]
INK = "#222222"

LIMIT_STYLES = {
    "reach": ("#999999", "reach of a link"),
    "stroke": ("#0072B2", "stroke of a slider"),
    "universal": ("#009E73", "universal joint of a leg"),
    "spherical": ("#E69F00", "spherical joint"),
    "tilt": ("#CC79A7", "universal joint of the passive leg"),
    "height": ("#56B4E9", "stop of the passive leg"),
}
"""Colours and labels of the chapter's limits; Okabe and Ito's colours suit all kinds of colour vision."""

_OTHER_COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#332288", "#882255")

_STYLE = {
    "font.family": "DejaVu Sans",  # included in matplotlib, so that pictures are identical everywhere
    "mathtext.fontset": "dejavusans",
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "figure.titlesize": 9.0,
    "legend.fontsize": 7.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.7,
    "xtick.direction": "out",
    "ytick.direction": "out",
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "savefig.facecolor": "white",
    "pdf.fonttype": 42,  # text remains text
    "svg.hashsalt": "pm3dof",
}
LIMIT_LINE: dict[str, Any] = {"color": INK, "linewidth": 1.0}
END_LINE: dict[str, Any] = {"color": "#777777", "linewidth": 1.0, "linestyle": (0, (3.0, 2.0))}
"""Edges of a map: a joint limit, and the end of the grid, beyond which the robot could move."""

FORMATS = ("png", "pdf", "svg", "dark.png")
"""Suffixes of pictures; the last is for dark pages."""
_WIDEST_TITLE, _SMALLEST_TITLE = 0.97, 5.0  # part of the picture's width; points
# names of metadata: title, software, command, and a date that is left out
_METADATA = {
    "png": ("Title", "Software", "Comment", None),
    "pdf": ("Title", "Creator", "Subject", "CreationDate"),
    "svg": ("Title", "Creator", "Description", "Date"),
}
_DATES = ("CreationDate", "Date")


def limit_styles(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return colour and label for each limit of a robot, from the lowest bit."""
    if set(names) <= set(LIMIT_STYLES):
        return {name: LIMIT_STYLES[name] for name in names}
    others = [name for name in names if name != "reach"]
    colors = dict(zip(others, itertools.cycle(_OTHER_COLORS), strict=False))
    return {name: (colors.get(name, LIMIT_STYLES["reach"][0]), plain(name.replace("_", " "))) for name in names}


def spring_colors(count: int) -> list[str]:
    """Return a colour for each spring."""
    return list(itertools.islice(itertools.cycle(_OTHER_COLORS), count))


def collected(style: dict[str, Any]) -> dict[str, Any]:
    """Convert the style of a line to that of a line collection."""
    return {f"{name}s": value for name, value in style.items()}


def round_ticks(axes: Any, across: int = 5, up: int = 5) -> None:
    """Set ticks at round numbers, at most so many along each axis."""
    for axis, count in ((axes.xaxis, across), (axes.yaxis, up)):
        axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10]))


def towards_viewer(elevation: float, azimuth: float) -> Array:
    """Return the unit vector towards the viewer of a drawing in space at an elevation and azimuth [deg].

    Matplotlib sorts by depth only within one collection: lines in a surface are in its collection, shifted slightly
    along this vector, so that they are sorted in front of it.
    """
    up, around = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


@contextmanager
def house_style() -> Iterator[None]:
    """Use the house style within the block; the user's settings are ignored inside and restored afterwards."""
    with style.context(["default", _STYLE]):
        yield


@contextmanager
def _fonts_undated() -> Iterator[None]:
    """Suppress log warnings about the dates of fonts."""
    log = logging.getLogger("fontTools")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure [inch] that needs no screen, to be filled within :func:`house_style`."""
    figure = Figure(figsize=(width, height), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path | str, command: str | None = None) -> Path:
    """Write a figure as PDF, SVG or PNG by suffix, and return the path; equal figures give equal bytes.

    A name that ends in .dark.png is drawn on a dark ground. A title wider than the picture is written smaller.
    Its metadata are its title, this package and version, and the command that drew it, if any.

    Raises:
        OutputError: the file cannot be written; no partial file is left.
    """
    kind = suffix if (suffix := Path(path).suffix[1:].lower()) in _METADATA else "png"
    title = re.sub(r"[$\\{}]", "", figure.get_suptitle()).replace("\n", "; ")
    texts = (title or None, f"pm3dof-pin {pm3dof_pin.__version__}", command, None)
    named = zip(_METADATA[kind], texts, strict=True)
    metadata = {name: text for name, text in named if name is not None and (text or name in _DATES)}
    is_dark = str(path).lower().endswith(".dark.png")
    with house_style(), _fonts_undated(), write_atomically(path) as temporary:
        fit_title(figure)
        with darkened(figure) if is_dark else nullcontext():
            _paint(figure, temporary, kind, metadata, {"facecolor": figure.get_facecolor()} if is_dark else {})
    return Path(path)


def _paint(figure: Figure, path: Path, kind: str, metadata: dict[str, str | None], ground: dict[str, Any]) -> None:
    """Render a figure to a file of a kind."""
    if kind != "png":
        figure.savefig(path, format=kind, dpi=DPI, metadata=metadata, **ground)
        return
    canvas = FigureCanvasAgg(figure)
    canvas.print_figure(io.BytesIO(), format="raw", dpi=DPI, **ground)
    pixels = np.asarray(canvas.renderer.buffer_rgba())  # of a size rounded there
    path.write_bytes(png(pixels, DPI, {name: text for name, text in metadata.items() if text}))


def fit_title(figure: Figure) -> None:
    """Write the title of a figure smaller, if it is wider than the picture."""
    title: Text | None = figure._suptitle  # type: ignore[attr-defined]
    if title is None:
        return
    room = _WIDEST_TITLE * figure.bbox.width
    width = title.get_window_extent(FigureCanvasAgg(figure).get_renderer(), dpi=figure.dpi).width
    if width > room:
        title.set_fontsize(max(_SMALLEST_TITLE, float(title.get_fontsize()) * room / width))


def save_pictures(
    figure: Figure, path: Path | str, formats: Sequence[str] = ("png",), command: str | None = None
) -> list[Path]:
    """Write a figure in several of :data:`FORMATS`; its files in other formats, from earlier runs, are removed.

    Raises:
        OutputError: a file cannot be written.
    """
    target = Path(path)
    written = [save_figure(figure, target.with_suffix(f".{kind}"), command) for kind in formats]
    for kind in FORMATS:
        if kind not in formats:
            target.with_suffix(f".{kind}").unlink(missing_ok=True)
    return written
