"""Files of poses: CSV with a column `name_deg`, `name_rad` or `name_m` for each coordinate or command of a robot."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import write_atomically
from pm3dof_pin.typing import Array, Matrix

_UNITS = {"m": {"m": 1.0}, "rad": {"deg": math.pi / 180.0, "rad": 1.0}}


@dataclass(frozen=True, eq=False)
class PoseFile:
    """Values of coordinates (or commands) as a file gives them.

    Attributes:
        path: the file.
        columns: heading of each coordinate's column, in the order of the coordinates.
        written: the numbers of these columns, shape=(n, number of coordinates) [units of the columns].
        values: the same, shape=(n, number of coordinates) [m, rad].
        unused: columns of the file that were not needed.
    """

    path: Path
    columns: tuple[str, ...]
    written: Matrix
    values: Matrix
    unused: tuple[str, ...]

    @property
    def columns_as_written(self) -> dict[str, Array]:
        """The columns by their headings, in the units of the file, shape=(n,) each."""
        return dict(zip(self.columns, self.written.T, strict=True))


def read_pose_file(path: Path | str, coordinates: Sequence[Coordinate], *, known: Sequence[str] = ()) -> PoseFile:
    """Read a file of poses.

    Args:
        path: CSV with a heading; blank lines and lines that start with # are skipped.
        coordinates: what the file gives: each in one column, `name_deg` or `name_rad` of an angle, `name_m` of a
            length.
        known: headings of columns that may stand there and are not needed.

    Raises:
        DescriptionError: the file cannot be read, a column is missing, unknown or there twice, or an entry is not a
            finite number.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no UTF-8 text"
        raise DescriptionError(path, "file", f"expected a readable file ({reason})") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise DescriptionError(path, "file", f"is empty, expected a heading such as {example_heading(coordinates)}")
    rows = [[cell.strip() for cell in row] for row in csv.reader(line for _, line in lines)]
    heading = rows[0]
    _require_known(path, heading, coordinates, known)
    columns = [_column(path, heading, coordinate, coordinates) for coordinate in coordinates]
    written = np.empty((len(rows) - 1, len(columns)))
    for row, (cells, (number, _)) in enumerate(zip(rows[1:], lines[1:], strict=True)):
        if len(cells) != len(heading):
            raise DescriptionError(path, f"line {number}", f"expected {len(heading)} entries, not {len(cells)}")
        for k, column in enumerate(columns):
            written[row, k] = _number(path, number, column, cells[heading.index(column)])
    factors = [
        _UNITS[coordinate.unit][column.rpartition("_")[2]]
        for column, coordinate in zip(columns, coordinates, strict=True)
    ]
    unused = tuple(name for name in heading if name not in columns)
    return PoseFile(path, tuple(columns), frozen(written), frozen(written * factors), unused)


def possible_headings(coordinate: Coordinate) -> list[str]:
    """Return the headings that a coordinate's column may have."""
    return [f"{coordinate.name}_{unit}" for unit in _UNITS[coordinate.unit]]


def heading_of(coordinate: Coordinate) -> str:
    """Return the heading under which a coordinate is written: angles in degrees."""
    return f"{coordinate.name}_{'m' if coordinate.unit == 'm' else 'deg'}"


def example_heading(coordinates: Sequence[Coordinate]) -> str:
    """Return the heading of a file with these coordinates."""
    return ",".join(map(heading_of, coordinates))


def write_columns(path: Path | str, columns: Mapping[str, ArrayLike | Sequence[str]]) -> Path:
    """Write columns of numbers or words as CSV, whole or not at all.

    Args:
        path: the file.
        columns: numbers, shape=(n,), or n words, by heading.

    Raises:
        OutputError: the file cannot be written.
    """
    with write_atomically(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        file.write(columns_text(columns))
    return Path(path)


def columns_text(columns: Mapping[str, ArrayLike | Sequence[str]]) -> str:
    """Return columns of numbers or words as the text of a CSV file; see :func:`write_columns`."""
    cells = [
        [entry if isinstance(entry, str) else f"{entry:.12g}" for entry in np.asarray(values).tolist()]
        for values in columns.values()
    ]
    return "".join(f"{','.join(row)}\n" for row in [tuple(columns), *zip(*cells, strict=True)])


def _require_known(path: Path, heading: Sequence[str], coordinates: Sequence[Coordinate], known: Sequence[str]) -> None:
    possible = {*known, *(name for coordinate in coordinates for name in possible_headings(coordinate))}
    if unknown := [name for name in heading if name not in possible]:
        expected = f"is unknown, expected a heading such as {example_heading(coordinates)}"
        raise DescriptionError(path, f"column {', '.join(unknown)}", expected)


def _column(path: Path, heading: Sequence[str], coordinate: Coordinate, coordinates: Sequence[Coordinate]) -> str:
    possible = possible_headings(coordinate)
    found = [name for name in heading if name in possible]
    if len(found) != 1:
        problem = "is missing" if not found else "stands there twice"
        expected = f"{problem}, expected {' or '.join(possible)}; a heading is {example_heading(coordinates)}"
        raise DescriptionError(path, f"column {coordinate.name}", expected)
    return found[0]


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise DescriptionError(path, f"line {line}", f"{column} = {text}: expected a finite number")
    return number
