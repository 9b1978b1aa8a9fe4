"""Poses given on the command line or in files: units checked, solved, and written."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import ArrayLike

from pm3dof_pin.cli.options import PlaceOptions, PoseOptions
from pm3dof_pin.cli.output import LIMIT_BROKEN, message, print_result, stop_on_broken_limits
from pm3dof_pin.description.coordinates import Coordinate, pose_in_words, shown_in
from pm3dof_pin.exceptions import (
    InvalidValueError,
    SingularConfigurationError,
    UnreachablePoseError,
    first_words,
)
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.branches import start_of
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.pose_file import BROKEN_LIMITS, Given, PoseTable, columns_text, read_poses
from pm3dof_pin.kinematics.poses import Poses, limit_names
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import unit_slip
from pm3dof_pin.typing import Vector

_TURN = 360.0  # [deg]
_ZERO = 1e-9  # numbers up to here are zeros with rounding [deg, m]
_FEW_DEGREES = 0.5


def place(robot: Robot, chosen: PlaceOptions) -> Poses:
    """Solve the chosen pose, shape=(); for a file of poses see :func:`read_table`.

    Raises:
        UnreachablePoseError: the pose is out of reach.
        PM3DofError: no configuration has this name, or its loops do not close.
    """
    if chosen.numbers:
        return solve_pose(robot, si_values(robot, robot.coordinates, chosen.numbers))
    return robot.at(_named_configuration(robot, chosen.configuration))


def solve_chosen(
    robot: Robot, chosen: PoseOptions, columns: Callable[[Poses], Mapping[str, ArrayLike]], as_json: bool
) -> Poses | None:
    """Solve the chosen pose, shape=(); for a file of poses, write `columns` after its own and return None."""
    if chosen.poses is None:
        return place(robot, chosen)
    table = read_table(robot, chosen.poses)
    write_batch(table.poses, dict(table.columns) | dict(columns(table.poses)), chosen.out, as_json)
    return None


def say_if_drives_are_dependent(robot: Robot) -> None:
    """Say it if the drives do not determine the pose anywhere, where an answer is true all the same."""
    try:
        robot.require_regular_drives(from_home=False)
    except SingularConfigurationError as error:
        message(f"pm3dof: {error}")


def print_at_pose(pose: Poses, result: Mapping[str, Any], lines: Sequence[str], *, as_json: bool) -> None:
    """Print one pose, shape=(), and a result about it; exit with status 1 if the pose breaks a limit."""
    robot = pose.robot
    say_if_drives_are_dependent(robot)
    header: dict[str, Any] = {"robot": robot.name}
    if robot.coordinates:
        header["pose"] = {c.name: float(value) for c, value in zip(robot.coordinates, pose.coordinates, strict=True)}
        lines = [f"pose {pose_in_words(robot.coordinates, pose.coordinates)}", "", *lines]
    print_result(header | dict(result), lines, as_json=as_json)
    stop_on_broken_limits(broken_limits(robot, pose.configuration()))


def solve_pose(robot: Robot, values: Vector, *, forward: bool = False) -> Poses:
    """Solve the pose at coordinates (or commands) [rad, m], shape=(); raise UnreachablePoseError if out of reach."""
    given = robot.command_coordinates if forward else robot.coordinates
    solve = robot.forward if forward else robot.solve
    with suppress(UnreachablePoseError):
        # for one pose, importing the compiler takes longer than solving without it, unless waypoints are needed
        return solve(values, guess=start_of(robot), engine="pinocchio")
    try:
        return solve(values)
    except UnreachablePoseError as error:
        raise UnreachablePoseError(
            f"pose {pose_in_words(given, values)} is out of reach: no assembled configuration was found "
            f"({error.reason}){_ranges_left(robot, given, values)}"
        ) from error


def read_table(robot: Robot, path: Path, *, given: Given = "coordinates", used: Sequence[str] = ()) -> PoseTable:
    """Read a table of poses, see :func:`~pm3dof_pin.kinematics.pose_file.read_poses`; name its columns not `used`."""
    table = read_poses(robot, path, given=given)
    if unused := [name for name in table.others if name not in used]:
        message(f"pm3dof: {path}: unused columns: {', '.join(unused)}")
    return table


def write_batch(poses: Poses, columns: Mapping[str, ArrayLike], out: Path | None, as_json: bool) -> None:
    """Write columns about many poses and the limits they break; exit with status 1 if any pose breaks one."""
    say_if_drives_are_dependent(poses.robot)
    table = {**columns, BROKEN_LIMITS: limit_words(poses)}
    inside = int(poses.within_limits.sum())
    if as_json:
        counts = {"robot": poses.robot.name, "poses": len(poses), "poses_within_limits": inside}
        print_result(counts | {"columns": table}, [], as_json=True)
    if out is not None:
        write_text_atomically(out, columns_text(table))
        message(f"wrote {out}")
    elif not as_json:
        typer.echo(columns_text(table), nl=False)
    if inside < len(poses):
        message(f"pm3dof: {len(poses) - inside} of {len(poses)} poses break a limit: see {BROKEN_LIMITS}")
        raise typer.Exit(LIMIT_BROKEN)


def names_and_units(coordinates: Sequence[Coordinate]) -> list[dict[str, str]]:
    """Return the names and units of coordinates for JSON."""
    return [{"name": coordinate.name, "unit": coordinate.unit} for coordinate in coordinates]


def with_units(coordinates: Sequence[Coordinate], values: Iterable[float]) -> dict[str, float]:
    """Return values of coordinates [rad, m] by NAME_UNIT, such as "theta_x_rad"."""
    return {f"{c.name}_{c.unit}": float(value) for c, value in zip(coordinates, values, strict=True)}


def column_of(name: str, unit: str) -> str:
    """Return the header of a column: name and unit."""
    return f"{name}_{unit.replace(' ', '_')}"


def si_values(robot: Robot, coordinates: Sequence[Coordinate], numbers: Sequence[float]) -> Vector:
    """Convert coordinates from [deg, m] to [rad, m] after checking their number and that their units are plausible."""
    if not coordinates:
        raise typer.BadParameter(f"{robot.name} has neither coordinates nor commands: use --configuration")
    if len(numbers) != len(coordinates):
        raise typer.BadParameter(f"{expected_numbers(robot, coordinates)}, not {len(numbers)} numbers")
    check_units(robot, coordinates, np.array([numbers]))
    return np.array([in_si(c.unit, number) for c, number in zip(coordinates, numbers, strict=True)])


def in_si(unit: str, number: float) -> float:
    """Convert a number from [deg, m] to [rad, m]."""
    return math.radians(number) if unit == "rad" else number


def expected_numbers(robot: Robot, coordinates: Sequence[Coordinate]) -> str:
    """Describe a pose of the robot: names, units and ranges."""
    words = []
    for coordinate in coordinates:
        factor, unit = shown_in(coordinate.unit)
        lower, upper = (f"{factor * end:.4g}" for end in robot.range_of(coordinate))
        limits = "" if "inf" in lower + upper else f" {lower} .. {upper}"
        words.append(f"{coordinate.name}{limits} [{unit}]")
    return f"{robot.name} takes {', '.join(words)}" if words else f"{robot.name} has no actuated joints, so none"


def check_units(robot: Robot, coordinates: Sequence[Coordinate], numbers: ArrayLike) -> None:
    """Reject numbers, shape=(n, number of coordinates) [deg, m], that look like another unit, and name that unit."""
    table = np.asarray(numbers, dtype=float)
    if not table.size:
        return
    angles = []
    for coordinate, column in zip(coordinates, table.T, strict=True):
        worst = float(column[np.abs(column).argmax()])
        worst = worst if abs(worst) > _ZERO else 0.0  # rounding has no unit
        if coordinate.unit == "m" and (slip := unit_slip(robot, coordinate, column)):
            found = f"{coordinate.name} = {worst:g} m looks like {slip.unit}"
            raise typer.BadParameter(f"{found}: expected metres ({worst / 1000:g})")
        if coordinate.unit == "rad" and (problem := _too_far(robot, coordinate, column, worst)):
            raise typer.BadParameter(f"{coordinate.name} {problem}")
        if coordinate.unit == "rad":
            angles.append((coordinate, worst))
    if any(worst for _, worst in angles) and all(abs(worst) < _FEW_DEGREES for _, worst in angles):
        small = ", ".join(f"{c.name} = {worst:g}" for c, worst in angles if worst)
        turned = ", ".join(f"{math.degrees(worst):.6g}" for _, worst in angles if worst)
        message(f"pm3dof: reading {small} as degrees; if radians were meant: {turned}")


def _ranges_left(robot: Robot, coordinates: Sequence[Coordinate], values: Vector) -> str:
    """Return the ranges of coordinates that are outside them, as in "; u3 ranges from 0.155 to 0.325 m"."""
    words = []
    for coordinate, value in zip(coordinates, values, strict=True):
        low, high = robot.range_of(coordinate)
        factor, unit = shown_in(coordinate.unit)
        if not low <= value <= high:
            words.append(f"{coordinate.name} ranges from {factor * low:.4g} to {factor * high:.4g} {unit}")
    return f"; {first_words(words)}" if words else ""


def _too_far(robot: Robot, coordinate: Coordinate, degrees: Vector, worst: float) -> str:
    """Return what is wrong with angles that cannot be meant, given the one farthest from zero; "" if nothing."""
    ends = np.degrees(robot.range_of(coordinate))
    has_range = bool(np.isfinite(ends).all())
    low, high = ends if has_range else (-_TURN, _TURN)
    if abs(worst) > max(_TURN, np.abs((low, high)).max()) + _ZERO and (has_range or coordinate.joint is None):
        return f"= {worst:g} deg is more than a full turn: expected {low:.4g} to {high:.4g} deg"
    if not unit_slip(robot, coordinate, np.radians(degrees)):
        return ""
    if has_range:
        return f"= {worst:g} deg is far beyond its range: expected {low:.4g} to {high:.4g} deg"
    return f"goes over {np.ptp(degrees):g} deg: expected at most a full turn, {_TURN:g} deg"


def limit_words(poses: Poses) -> list[str]:
    """Return one word per pose: the limit groups it breaks, or "reach" if it is out of reach."""
    names = limit_names(poses.robot)
    return [
        "+".join(name for bit, name in enumerate(names) if flags & (1 << bit))
        for flags in poses.broken_limits.ravel().tolist()
    ]


def _named_configuration(robot: Robot, name: str | None) -> Vector:
    named = robot.named_configurations
    if name is None or name == "home":
        return robot.assemble().q
    if name not in named:
        expected = f"one of {', '.join(named)}" if named else "home, the only one there is"
        raise InvalidValueError("--configuration", name, expected)
    return robot.assemble(named[name]).q
