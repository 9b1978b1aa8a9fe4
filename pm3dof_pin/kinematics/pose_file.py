"""Pose files: CSV with a column `name_deg`, `name_rad` or `name_m` for each coordinate or command of a robot."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pm3dof_pin.arrays import frozen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import csv_text, read_text, without_apostrophe
from pm3dof_pin.typing import Array, Matrix

QUATERNION = ("qw", "qx", "qy", "qz")
"""Headings of a unit quaternion, the orientation of the tool."""

UNIT_QUATERNION = 1e-2  # tolerance of the norm; more than the rounding of a few printed digits


@dataclass(frozen=True, eq=False)
class PoseFile:
    """Values of coordinates (or commands) in a file."""

    path: Path  #: the file
    columns: tuple[str, ...]  #: heading of each coordinate's column, in order of the coordinates
    written: Matrix  #: the numbers of these columns, shape=(n, number of coordinates) [units of the columns]
    values: Matrix  #: the same, shape=(n, number of coordinates) [m, rad]
    unused: tuple[str, ...]  #: unused columns of the file
    #: further requested columns of numbers that the file has, by heading, shape=(n,) each
    numbers: Mapping[str, Array] = field(default_factory=dict)

    @property
    def columns_as_written(self) -> dict[str, Array]:
        """The columns by heading, in the units of the file, shape=(n,) each."""
        return dict(zip(self.columns, self.written.T, strict=True))

    @classmethod
    def read(
        cls,
        path: Path | str,
        coordinates: Sequence[Coordinate],
        *,
        known: Sequence[str] = (),
        numbers: Sequence[str] = (),
    ) -> PoseFile:
        """Read a CSV file of poses with a header; blank lines and lines starting with # are skipped.

        Each coordinate has one column: `name_deg` or `name_rad` for an angle, `name_m` for a length. Columns `known`
        are permitted, columns `numbers` are read if present.

        Raises:
            DescriptionError: the file is unreadable, a column is missing, unknown or duplicate, or an entry is not a
                finite number.
        """
        path = Path(path)
        lines = [(number, line) for number, line in enumerate(read_text(path).splitlines(), start=1)]
        lines = [(number, line) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]
        if not lines:
            raise DescriptionError(path, "file", f"is empty, expected a header such as {_example_heading(coordinates)}")
        try:
            rows = [[without_apostrophe(cell.strip()) for cell in row] for row in csv.reader(line for _, line in lines)]
        except csv.Error as error:
            raise DescriptionError(path, "file", f"expected CSV ({error})") from error
        heading = rows[0]
        _require_known(path, heading, coordinates, (*known, *numbers))
        columns = [_column(path, heading, coordinate, coordinates) for coordinate in coordinates]
        columns += [name for name in numbers if name in heading]
        written = np.empty((len(rows) - 1, len(columns)))
        for row, (cells, (number, _)) in enumerate(zip(rows[1:], lines[1:], strict=True)):
            if len(cells) != len(heading):
                raise DescriptionError(path, f"line {number}", f"expected {len(heading)} entries, not {len(cells)}")
            for k, column in enumerate(columns):
                written[row, k] = _number(path, number, column, cells[heading.index(column)])
        factors = [math.pi / 180.0 if column.endswith("_deg") else 1.0 for column in columns[: len(coordinates)]]
        count = len(coordinates)
        unused = tuple(name for name in heading if name not in columns)
        values = written[:, :count] * factors
        further = dict(zip(columns[count:], written[:, count:].T, strict=True))
        return cls(path, tuple(columns[:count]), frozen(written[:, :count]), frozen(values), unused, further)

    @classmethod
    def read_placements(
        cls, path: Path | str, *, known: Sequence[str] = (), numbers: Sequence[str] = ()
    ) -> tuple[PoseFile, Array]:
        """Read tool placements like :meth:`read`, in columns x_m, y_m, z_m, qw, qx, qy, qz; also return transforms.

        Raises:
            DescriptionError: as there; or a quaternion is missing or not of unit length.
        """
        position = [Coordinate(name, "m", tool=name) for name in TOOL_COMPONENTS[:3]]
        file = cls.read(path, position, known=known, numbers=(*QUATERNION, *numbers))
        if missing := [name for name in QUATERNION if name not in file.numbers]:
            raise DescriptionError(
                path, f"column {', '.join(missing)}", f"is missing, expected {', '.join(QUATERNION)}"
            )
        quaternions = np.stack([file.numbers[name] for name in QUATERNION], axis=-1)
        lengths = np.linalg.norm(quaternions, axis=-1)
        if not np.all(np.abs(lengths - 1.0) < UNIT_QUATERNION):
            worst = lengths[np.abs(lengths - 1.0).argmax()]
            raise DescriptionError(path, ", ".join(QUATERNION), f"a quaternion of length {worst:.6g}, expected 1")
        transforms = np.zeros((len(quaternions), 4, 4))
        transforms[:, :3, :3] = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix()
        transforms[:, :3, 3] = file.values
        transforms[:, 3, 3] = 1.0
        written = np.concatenate([file.written, quaternions], axis=1)
        others = {name: values for name, values in file.numbers.items() if name not in QUATERNION}
        return replace(file, columns=(*file.columns, *QUATERNION), written=frozen(written), numbers=others), transforms

    @staticmethod
    def gives_placements(path: Path | str) -> bool:
        """Return whether a file contains tool placements with quaternions; False if it is unreadable."""
        try:
            lines = read_text(path).splitlines()
        except DescriptionError:
            return False
        heading = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
        return QUATERNION[0] in (name.strip() for name in heading.split(","))


def _example_heading(coordinates: Sequence[Coordinate]) -> str:
    """Return the header of a file with these coordinates."""
    return ",".join(coordinate.heading for coordinate in coordinates)


def columns_text(columns: Mapping[str, ArrayLike | Sequence[str]]) -> str:
    """Return columns of numbers or words as CSV text."""
    cells = [
        [entry if isinstance(entry, str) else f"{entry:.12g}" for entry in np.asarray(values).tolist()]
        for values in columns.values()
    ]
    return csv_text([tuple(columns), *zip(*cells, strict=True)])


def _require_known(path: Path, heading: Sequence[str], coordinates: Sequence[Coordinate], known: Sequence[str]) -> None:
    possible = {*known, *(name for coordinate in coordinates for name in coordinate.headings)}
    if unknown := [name for name in heading if name not in possible]:
        expected = f"is unknown, expected a header such as {_example_heading(coordinates)}"
        raise DescriptionError(path, f"column {', '.join(unknown)}", expected)


def _column(path: Path, heading: Sequence[str], coordinate: Coordinate, coordinates: Sequence[Coordinate]) -> str:
    possible = coordinate.headings
    found = [name for name in heading if name in possible]
    if len(found) != 1:
        problem = "is missing" if not found else "appears twice"
        expected = f"{problem}, expected {' or '.join(possible)}; an example header is {_example_heading(coordinates)}"
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
