"""Tables of poses: CSV files of coordinates, commands or placements of the tool, in any columns and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import require_choice
from pm3dof_pin.csv_table import CsvTable
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, shown_in, tool_coordinates
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.files import csv_text
from pm3dof_pin.kinematics.actuation import motion_components
from pm3dof_pin.kinematics.mobility import generic_configuration
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import unit_slip
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.typing import Array

PLACEMENT = (*(f"{name}_m" for name in TOOL_COMPONENTS[:3]), "qw", "qx", "qy", "qz")
"""Columns of a placement of the tool in the base: position [m] and unit quaternion."""

BROKEN_LIMITS = "broken_limits"
"""Column of words: the limits that a pose breaks."""

_PLACEMENT_DIGITS = 1e-5  # agreement of a placement with the tool's motions [characteristic lengths, rad]
UNIT_QUATERNION = 1e-2  # tolerance of the norm; more than the rounding of a few printed digits

Given: TypeAlias = Literal["coordinates", "commands"]
"""What a table gives of its poses; a placement of the tool stands for the coordinates."""


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Poses of a file, and its other columns."""

    poses: Poses  #: the poses, shape=(n,); NaN where they are out of reach, or were so when the file was written
    columns: Mapping[str, Array]  #: the columns that give the poses, as written in the file, shape=(n,) each
    others: Mapping[str, Array]  #: other columns of numbers, by name, in metres and radians, shape=(n,) each
    lines: Sequence[int] = ()  #: line of the file of each pose


def read_poses(robot: Robot, path: Path | str, *, given: Given = "coordinates") -> PoseTable:
    r"""Read a CSV file of poses and solve them.

    A coordinate or command `name` has a column `name_deg` or `name_rad`, or `name_m` or `name_mm`; commands may also be
    numbered, `u1_m`. Without coordinates a pose is given by the placement of the tool, in columns x_m, y_m, z_m, qw,
    qx, qy, qz. Other columns are allowed, so that what one command writes the next can read. A file without a header
    has the coordinates in their order, angles in degrees and lengths in metres, separated by blanks or commas.

    Example:
        >>> from pathlib import Path
        >>> import pm3dof_pin as pm
        >>> text = "theta_x_deg,theta_y_deg,z_e_m\n10,-15,0.5\n0,3,0.48\n"
        >>> _ = Path("poses.csv").write_text(text)
        >>> pm.read_poses(pm.load("pm3dof"), "poses.csv").poses.commands.shape
        (2, 3)

    Args:
        robot: the robot.
        path: the file.
        given: what is read if the file has both; without coordinates and placements, commands are.

    Raises:
        MeasurementError: the file is unreadable, a column is missing or twice there, a row is incomplete, a quaternion
            is not of unit length, or a column is in another unit.
    """
    require_choice("given", given, Given)
    headless = [c.heading for c in (robot.coordinates if given == "coordinates" else robot.command_coordinates)]
    table = CsvTable(Path(path), (), headings=headless, words=(BROKEN_LIMITS,))
    columns, commands = _columns(robot.coordinates, table), _columns(robot.command_coordinates, table)
    if given == "coordinates" and not columns and set(PLACEMENT) <= set(table.header):
        columns = PLACEMENT
        poses = _poses_at(robot, _transforms(table, _rows(table, columns)))
    elif given == "commands" or (not set(_headings(robot.coordinates)) & set(table.header) and commands):
        columns = commands or _required(robot, table, robot.command_coordinates)
        poses = robot.forward(_values(robot, table, robot.command_coordinates, columns), on_failure="nan")
    else:
        columns = columns or _required(robot, table, robot.coordinates)
        poses = robot.solve(_values(robot, table, robot.coordinates, columns), on_failure="nan")
    others = {name: values for name, values in table.columns.items() if name not in columns}
    written = dict(zip(table.columns, table.written.items(), strict=True))
    return PoseTable(poses, dict(written[name] for name in columns), others, table.lines)


def readings(coordinates: Sequence[Coordinate], values: Array) -> dict[str, Array]:
    """Return columns of coordinate values, shape=(n, number of coordinates) [m, rad]; angles are in degrees there."""
    return {c.heading: shown_in(c.unit)[0] * column for c, column in zip(coordinates, values.T, strict=True)}


def placement_readings(poses: Poses) -> dict[str, Array]:
    """Return the columns :data:`PLACEMENT` of poses, shape=(n,)."""
    quaternions = np.full((len(poses), 4), np.nan)
    for row in np.flatnonzero(poses.solved):
        quaternions[row] = pin.Quaternion(poses.rotations[row]).coeffs()[[3, 0, 1, 2]]
    return dict(zip(PLACEMENT, np.column_stack([poses.positions, quaternions]).T, strict=True))


def columns_text(columns: Mapping[str, ArrayLike | Sequence[str]]) -> str:
    """Return columns of numbers or words as CSV text."""
    cells = [
        [entry if isinstance(entry, str) else f"{entry:.12g}" for entry in np.asarray(values).tolist()]
        for values in columns.values()
    ]
    return csv_text([tuple(columns), *zip(*cells, strict=True)])


def _headings(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    return tuple(f"{coordinate.name}_{coordinate.unit}" for coordinate in coordinates)


def _columns(coordinates: Sequence[Coordinate], table: CsvTable) -> tuple[str, ...]:
    """Return the columns of coordinates, or of numbered commands u1, u2 ...; none if the table lacks one."""
    numbered = tuple(f"u{k}_{coordinate.unit}" for k, coordinate in enumerate(coordinates, start=1))
    return next((names for names in (_headings(coordinates), numbered) if set(names) <= set(table.header)), ())


def _required(robot: Robot, table: CsvTable, coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return no columns for a robot without coordinates; else name those that are missing."""
    if not coordinates:
        raise MeasurementError(table.path, f"{robot.name} has neither coordinates nor commands")
    header = ",".join(coordinate.heading for coordinate in coordinates)
    if not table.header:
        raise MeasurementError(table.path, f"is empty, expected a header such as {header}")
    missing = [c.heading for c, name in zip(coordinates, _headings(coordinates), strict=True) if name not in table]
    by_tool = robot.tool_frame is not None and coordinates != robot.command_coordinates
    whole = f", or {','.join(PLACEMENT)}" if by_tool else ""
    problem = f"no column {', '.join(missing)}; expected a header such as {header}{whole}"
    raise MeasurementError(table.path, problem, [table.header_line])


def _values(robot: Robot, table: CsvTable, coordinates: Sequence[Coordinate], names: Sequence[str]) -> Array:
    """Return values of coordinates, shape=(n, number of coordinates) [m, rad], after judging their units."""
    values = _rows(table, names)
    written = dict(zip(table.columns, table.written.items(), strict=True))
    for coordinate, name, column in zip(coordinates, names, values.T, strict=True):
        heading, numbers = written[name]
        if heading == name and (slip := unit_slip(robot, coordinate, column)):
            problem = f"{heading} = {numbers[slip.index]:.6g} looks like {slip.unit}; expected {slip.expected}"
            raise MeasurementError(table.path, problem, [table.lines[slip.index]])
    return values


def _rows(table: CsvTable, names: Sequence[str]) -> Array:
    """Return columns side by side; a row may be NaN throughout, as for poses out of reach, but not in part."""
    values = table.matrix(names)
    known = np.isfinite(values)
    if (partly := known.any(axis=1) & ~known.all(axis=1)).any() or np.isinf(values).any():
        wrong = partly | np.isinf(values).any(axis=1)
        raise MeasurementError(table.path, f"expected finite numbers in {', '.join(names)}", table.lines_where(wrong))
    return values


def _poses_at(robot: Robot, transforms: Array) -> Poses:
    """Solve placements of the tool.

    With fewer than six degrees of freedom, digits of a file never fit all six numbers: such a tool is placed by as many
    components of its placement as it has motions, and the others must agree.
    """
    components = motion_components(generic_configuration(robot.home))
    if len(components) == len(TOOL_COMPONENTS):
        return robot.reach(transforms, on_failure="nan")
    chosen = [TOOL_COMPONENTS.index(component) for component in components]
    placed = robot.replace(coordinates=tool_coordinates(components))
    poses = placed.solve(tool_components(transforms)[:, chosen], on_failure="nan")
    off = np.abs(poses.transforms - transforms)
    off[:, :3, 3] /= robot.characteristic_length
    agree = off.max(axis=(1, 2), initial=0.0) <= _PLACEMENT_DIGITS
    return robot.at(np.where(agree[:, None], poses.q, np.nan))


def _transforms(table: CsvTable, values: Array) -> Array:
    lengths = np.linalg.norm(values[:, 3:], axis=1)
    if (wrong := np.abs(lengths - 1.0) > UNIT_QUATERNION).any():
        problem = f"{','.join(PLACEMENT[3:])} has length {lengths[wrong][0]:.6g}, expected 1"
        raise MeasurementError(table.path, problem, table.lines_where(wrong))
    transforms = np.full((len(values), 4, 4), np.nan)
    for row in np.flatnonzero(np.isfinite(lengths)):
        x, y, z, *parts = values[row].tolist()
        transforms[row] = pin.SE3(pin.Quaternion(*parts).normalized(), np.array([x, y, z])).homogeneous
    return transforms
