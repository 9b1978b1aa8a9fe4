"""Poses given on the command line or in files: units checked, solved, and written."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from pm3dof_pin.cli.options import PlaceOptions, PoseOptions
from pm3dof_pin.cli.output import LIMIT_BROKEN, message, print_result, stop_on_broken_limits
from pm3dof_pin.description.coordinates import Coordinate, shown_in
from pm3dof_pin.kinematics.broken_limits import broken_limits

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pm3dof_pin.kinematics.pose_file import PoseFile
    from pm3dof_pin.kinematics.poses import Poses
    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.typing import Array, Vector

BROKEN_LIMITS = "broken_limits"
"""Header of the column that names the limits a pose breaks."""

_FAR = 100.0  # lengths beyond this many machine sizes are taken to be in another unit
_MOST_DEGREES = 360.0
_FEW_DEGREES = 0.5


def place(robot: Robot, chosen: PlaceOptions) -> Poses:
    """Solve the chosen pose, shape=(); for a file of poses see :func:`read_poses`.

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
    file, many = read_poses(robot, chosen.poses)
    write_batch(many, file.columns_as_written | dict(columns(many)), chosen.out, as_json)
    return None


def print_at_pose(pose: Poses, result: Mapping[str, Any], lines: Sequence[str], *, as_json: bool) -> None:
    """Print one pose, shape=(), and a result about it; exit with status 1 if the pose breaks a limit."""
    robot = pose.robot
    header: dict[str, Any] = {"robot": robot.name}
    if robot.coordinates:
        header["pose"] = {c.name: float(value) for c, value in zip(robot.coordinates, pose.coordinates, strict=True)}
        lines = [f"pose {_pose_in_words(robot.coordinates, pose.coordinates)}", "", *lines]
    print_result(header | dict(result), lines, as_json=as_json)
    stop_on_broken_limits(broken_limits(robot, pose.configuration()))


def solve_pose(robot: Robot, values: Vector, *, forward: bool = False) -> Poses:
    """Solve the pose at coordinates (or commands) [rad, m], shape=(); raise UnreachablePoseError if out of reach."""
    from pm3dof_pin.exceptions import UnreachablePoseError

    given = robot.command_coordinates if forward else robot.coordinates
    try:
        # for one pose, importing the compiler takes longer than solving without it
        solve = robot.forward if forward else robot.solve
        return solve(values, engine="pinocchio")
    except UnreachablePoseError as error:
        raise UnreachablePoseError(
            f"pose {_pose_in_words(given, values)} is out of reach: no assembled configuration was found "
            f"({error.reason}){_ranges_left(robot, given, values)}"
        ) from error


def read_poses(
    robot: Robot, path: Path, *, forward: bool = False, placements: bool = False, numbers: Sequence[str] = ()
) -> tuple[PoseFile, Poses]:
    """Read a file of poses (`forward`: of commands) and solve them; poses out of reach are NaN.

    It may hold `placements` of the tool, x_m, y_m, z_m, qw, qx, qy, qz, instead of coordinates; optional columns
    `numbers` are read if present.

    Raises:
        DescriptionError: the file cannot be read, or a column or entry is wrong.
    """
    import numpy as np

    from pm3dof_pin.kinematics.pose_file import PoseFile

    if placements and PoseFile.gives_placements(path):
        file, transforms = PoseFile.read_placements(path, known=[BROKEN_LIMITS], numbers=numbers)
        return file, robot.reach(transforms, on_failure="nan")
    given, others = robot.coordinates, robot.command_coordinates
    if forward:
        given, others = others, given
    known = [heading for coordinate in others for heading in coordinate.headings]
    file = PoseFile.read(path, given, known=[*known, BROKEN_LIMITS], numbers=numbers)
    if file.unused:
        message(f"pm3dof: {path}: unused columns: {', '.join(file.unused)}")
    check_units(robot, given, file.values * _factors(given))
    solve = robot.forward if forward else robot.solve
    return file, solve(np.array(file.values), on_failure="nan")


def write_batch(poses: Poses, columns: Mapping[str, ArrayLike], out: Path | None, as_json: bool) -> None:
    """Write columns about many poses and the limits they break; exit with status 1 if any pose breaks one."""
    from pm3dof_pin.files import write_text_atomically
    from pm3dof_pin.kinematics.pose_file import columns_text

    table = {**columns, BROKEN_LIMITS: _limit_words(poses)}
    inside = int(poses.within_limits.sum())
    if as_json:
        print_result({"poses": len(poses), "poses_within_limits": inside, "columns": table}, [], as_json=True)
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


def in_words(name: str, unit: str, value: float, digits: str = ".9g") -> str:
    """Format a value [rad, m] as in "theta_x = 10 deg", with the format `digits`."""
    factor, shown = shown_in(unit)
    return f"{name} = {round(factor * value, 9) + 0.0:{digits}} {shown}"


def column_of(name: str, unit: str) -> str:
    """Return the header of a column: name and unit."""
    return f"{name}_{unit.replace(' ', '_')}"


def readings(coordinates: Sequence[Coordinate], values: Array) -> dict[str, Array]:
    """Return file columns, angles in degrees, of coordinate values, shape=(n, number of coordinates)."""
    return {c.heading: shown_in(c.unit)[0] * column for c, column in zip(coordinates, values.T, strict=True)}


def si_values(robot: Robot, coordinates: Sequence[Coordinate], numbers: Sequence[float]) -> Vector:
    """Convert coordinates from [deg, m] to [rad, m] after checking their number and that their units are plausible."""
    import numpy as np

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
    import numpy as np

    table = np.asarray(numbers, dtype=float)
    if not table.size:
        return
    size = max(robot.characteristic_length, *(abs(v) for c, v in _home_of(robot, coordinates) if c.unit == "m"), 0.0)
    angles = []
    for coordinate, column in zip(coordinates, table.T, strict=True):
        worst = float(column[np.abs(column).argmax()])
        if coordinate.unit == "m" and abs(worst) > _FAR * size:
            raise typer.BadParameter(
                f"{coordinate.name} = {worst:g} m looks like millimetres: expected metres ({worst / 1000:g})"
            )
        if coordinate.unit == "rad" and abs(worst) > _MOST_DEGREES:
            raise typer.BadParameter(f"{coordinate.name} = {worst:g} deg is more than a full turn: expected degrees")
        if coordinate.unit == "rad":
            angles.append((coordinate, worst))
    if any(worst for _, worst in angles) and all(abs(worst) < _FEW_DEGREES for _, worst in angles):
        small = ", ".join(f"{c.name} = {worst:g}" for c, worst in angles if worst)
        turned = ", ".join(f"{math.degrees(worst):.6g}" for _, worst in angles if worst)
        message(f"pm3dof: reading {small} as degrees; if radians were meant: {turned}")


def _pose_in_words(coordinates: Sequence[Coordinate], values: Sequence[float] | Vector) -> str:
    """Return a pose [rad, m] as `theta_x = 10 deg, z_e = 0.5 m`."""
    return ", ".join(in_words(c.name, c.unit, value) for c, value in zip(coordinates, values, strict=True))


def _ranges_left(robot: Robot, coordinates: Sequence[Coordinate], values: Vector) -> str:
    """Return the ranges of coordinates that are outside them, as in "; u3 ranges from 0.155 to 0.325 m"."""
    words = []
    for coordinate, value in zip(coordinates, values, strict=True):
        low, high = robot.range_of(coordinate)
        factor, unit = shown_in(coordinate.unit)
        if not low <= value <= high:
            words.append(f"{coordinate.name} ranges from {factor * low:.4g} to {factor * high:.4g} {unit}")
    return f"; {', '.join(words)}" if words else ""


def _limit_words(poses: Poses) -> list[str]:
    """Return one word per pose: the limit groups it breaks, or "reach" if it is out of reach."""
    names = ("reach", *(group.name for group in poses.robot.limit_groups))
    return [
        "+".join(name for bit, name in enumerate(names) if flags & (1 << bit))
        for flags in poses.broken_limits.ravel().tolist()
    ]


def _named_configuration(robot: Robot, name: str | None) -> Vector:
    from pm3dof_pin.exceptions import InvalidValueError

    named = robot.named_configurations
    if name is None or (name == "home" and "home" not in named):
        return robot.assemble(robot.home).q
    if name not in named:
        expected = f"one of {', '.join(named)}" if named else "home, the only one there is"
        raise InvalidValueError("--configuration", name, expected)
    return robot.assemble(named[name]).q


def _home_of(robot: Robot, coordinates: Sequence[Coordinate]) -> list[tuple[Coordinate, float]]:
    home = robot.at(robot.home.q)
    transforms = home.transforms if any(coordinate.tool for coordinate in coordinates) else None
    return list(zip(coordinates, robot.read(tuple(coordinates), home.q, transforms), strict=True))


def _factors(coordinates: Sequence[Coordinate]) -> Any:
    """Return the factors from SI to command-line units, shape=(number of coordinates,)."""
    import numpy as np

    return np.array([shown_in(coordinate.unit)[0] for coordinate in coordinates])
