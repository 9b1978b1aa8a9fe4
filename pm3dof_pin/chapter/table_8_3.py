"""Table 8.3: published and computed, side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.chapter.chapter_stiffness import AXES, chapter_stiffness, global_index
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.chapter.tilt_grids import PolarGrid
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.description.robots import robots_directory
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

_STATISTICS: dict[str, Callable[[NDArray[np.float64]], Any]] = {
    "minimum": np.min,
    "maximum": np.max,
    "average": np.mean,
}


@dataclass(frozen=True)
class TableRow:
    """One number of Table 8.3."""

    axis: str  #: theta_x, theta_y, t_z, t_x (same as t_y), theta_z or global
    statistic: str  #: minimum, maximum or average over the section
    published: float  #: as printed
    computed: float  #: by this package
    remark: str  #: comment on the printed number, or an empty string

    @property
    def relative_difference(self) -> float:
        """(computed - published) / published."""
        return (self.computed - self.published) / self.published

    @property
    def last_digit_difference(self) -> int:
        """Difference in units of the last printed digit, the fifth, after rounding the computed number to it."""
        unit = 10.0 ** (math.floor(math.log10(abs(self.published))) - 4)
        return round(self.computed / unit) - round(self.published / unit)


def table_8_3(
    tripod: Tripod | None = None, published: Path | str | None = None, *, robot: Robot | None = None
) -> list[TableRow]:
    """Compute Table 8.3 on the chapter's grid and pair it with the published numbers, one row each, in its order.

    `published` is the YAML file with these; `robot` is the same machine, to compute with Pinocchio's Jacobians
    instead of the closed form.

    Raises:
        DescriptionError: the published table is missing or malformed.
    """
    tripod = tripod if tripod is not None else Tripod.load()
    default = robots_directory() / "pm3dof_description" / "config" / "table_8_3.yaml"
    path = Path(published) if published is not None else default
    computed = _section_values(tripod, robot)
    return [row for entry in _entries(path) for row in _rows(path, entry, computed)]


def _section_values(tripod: Tripod, robot: Robot | None) -> dict[str, NDArray[np.float64]]:
    """Values of every axis at the chapter's poses within all joint limits."""
    poses = PolarGrid().poses(tripod.middle_height)
    poses = poses[limit_flags(tripod, poses) == 0]
    if robot is None:
        diagonal = chapter_stiffness(tripod, poses)
    else:
        from pm3dof_pin.chapter.pinocchio_stiffness import pinocchio_stiffness  # loading Pinocchio is slow

        diagonal = pinocchio_stiffness(robot, tripod, poses)
    return dict(zip(AXES, diagonal.T, strict=True)) | {"global": global_index(diagonal)}


def _entries(path: Path) -> list[dict[str, Any]]:
    rows = read_mapping(path).get("rows")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise DescriptionError(path, "rows", "expected a list of mappings with axis and its statistics")
    return rows


def _rows(path: Path, entry: Mapping[str, Any], computed: Mapping[str, NDArray[np.float64]]) -> list[TableRow]:
    axis = entry.get("axis")
    if not isinstance(axis, str) or axis not in computed:
        raise DescriptionError(path, f"axis '{axis}'", f"expected one of {', '.join(computed)}")
    remarks = entry.get("remarks", {})
    rows = []
    for statistic, reduce in _STATISTICS.items():
        published = entry.get(statistic)
        if published is None:
            continue
        if not isinstance(published, float):
            raise DescriptionError(path, f"{axis}.{statistic}", f"'{published}' is not a number")
        rows.append(TableRow(axis, statistic, published, float(reduce(computed[axis])), remarks.get(statistic, "")))
    return rows
