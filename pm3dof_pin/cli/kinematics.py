"""`pm3dof ik` and `pm3dof fk`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pm3dof_pin.chapter.direct_kinematics import all_assembly_modes, newton
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.cli.options import Json, MachineOptions, NamedConfiguration, OutFile, PoseOptions, finite_number
from pm3dof_pin.cli.output import LIMIT_BROKEN, fixed, message, print_result, stop_on_broken_limits, table_lines
from pm3dof_pin.cli.poses import (
    expected_numbers,
    names_and_units,
    place,
    read_table,
    say_if_drives_are_dependent,
    si_values,
    solve_chosen,
    solve_pose,
    with_units,
    write_batch,
)
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, shown_in, value_in_words
from pm3dof_pin.exceptions import UnreachablePoseError, first_words
from pm3dof_pin.kinematics.assembly_modes import AssemblyModes, assembly_modes
from pm3dof_pin.kinematics.broken_limits import BrokenLimit, broken_limits, closure_names
from pm3dof_pin.kinematics.pose_file import placement_readings, readings
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.typing import Vector

_SHOWN_JOINTS = 8  # passive joints at most in a table of assembly modes
_TIMES = 5  # each assembly mode is to be met

Commands = Annotated[
    list[float] | None,
    typer.Argument(
        metavar="U",
        parser=finite_number,
        help="The robot's commands in order, lengths [m], angles [deg]; `pm3dof info` lists them.",
    ),
]


def ik(
    chosen: PoseOptions,
    which: MachineOptions,
    as_json: Json = False,
) -> None:
    """Compute the drive commands for a pose (inverse kinematics): angles in degrees, lengths in metres.

    Commands are the readings of the drives' counters; passive joint positions are listed too. A pose that breaks a
    joint limit is still computed, with a message and exit status 1.
    """
    machine = which.load()
    if chosen.is_empty:
        raise typer.BadParameter(f"expected a pose: {expected_numbers(machine, machine.coordinates)}")
    solved = solve_chosen(machine, chosen, lambda poses: readings(machine.command_coordinates, poses.commands), as_json)
    if solved is None:
        return
    result, broken = _result(machine, solved)
    say_if_drives_are_dependent(machine)
    print_result(result, _ik_lines(machine, result), as_json=as_json)
    stop_on_broken_limits(broken)


def fk(
    which: MachineOptions,
    u: Commands = None,
    configuration: NamedConfiguration = None,
    poses: Annotated[
        Path | None,
        typer.Option("--poses", metavar="FILE", help="Many poses: CSV with a column NAME_m or NAME_deg per command."),
    ] = None,
    out: OutFile = None,
    all_modes: Annotated[bool, typer.Option("--all", help="List every assembly mode, on whatever branch.")] = False,
    as_json: Json = False,
) -> None:
    """Compute the pose for drive commands (forward kinematics): lengths in metres, angles in degrees.

    Without --all, this is the pose reached from home. A pose that breaks a joint limit is still computed, with a
    message and exit status 1. With --all, exit status 1 also means that no listed mode is reached from home; modes are
    found from random starts, with an estimate of how many there are, and for the chapter's machine in closed form.
    """
    chosen = PoseOptions(pose=u, configuration=configuration, poses=poses, out=out)
    if all_modes and poses is not None:
        raise typer.BadParameter("--all is for commands on the command line, not for --poses")
    machine = which.load()
    if chosen.is_empty:
        raise typer.BadParameter(f"expected commands: {expected_numbers(machine, machine.command_coordinates)}")
    if poses is not None:
        table = read_table(machine, poses, given="commands")
        found = readings(machine.coordinates, table.poses.coordinates)
        found |= {} if machine.tool_frame is None else placement_readings(table.poses)
        write_batch(table.poses, dict(table.columns) | found, out, as_json)
        return
    modes: list[Vector] = []
    residuals: list[float] = []
    if configuration is not None:
        solved = place(machine, chosen)
        commands = solved.commands
    else:
        commands = si_values(machine, machine.command_coordinates, chosen.numbers)
        if all_modes:
            solved = machine.forward(commands, on_failure="nan")
        else:
            solved = solve_pose(machine, commands, forward=True)
    found_modes = None
    if all_modes and which.is_the_tripod:
        modes, residuals = _all_modes(commands, which.tripod())
    elif all_modes:
        found_modes = _found_modes(machine, commands)
        modes, residuals = list(found_modes.poses.coordinates), found_modes.poses.residual.tolist()
    result, broken = _result(machine, solved)
    if all_modes:
        result["assembly_modes"] = [
            with_units(machine.coordinates, mode) | {"residual_m": residual}
            for mode, residual in zip(modes, residuals, strict=True)
        ]
    lines = _pose_lines(machine.coordinates, modes if all_modes else [solved.coordinates])
    if found_modes is not None:
        if machine.coordinates == machine.command_coordinates:
            lines = _mode_lines(found_modes.poses)
        result |= {"starts": found_modes.starts, "estimated_modes": found_modes.estimated}
        result["missed_probability"] = found_modes.missed
        for entry, pose, times in zip(result["assembly_modes"], found_modes.poses, found_modes.counts, strict=True):
            entry |= {"within_limits": not broken_limits(machine, pose), "found": times, "joints": _joints(pose)}
        lines.append(_completeness(found_modes))
    if solved.solved and machine.tool_frame is not None:
        components = dict(zip(TOOL_COMPONENTS, tool_components(solved.transforms), strict=True))
        result["tool"] = {f"{k}_{'m' if k in 'xyz' else 'rad'}": float(value) for k, value in components.items()}
        words = (value_in_words(k, "m" if k in "xyz" else "rad", value) for k, value in components.items())
        lines += ["", f"tool {machine.tool_frame}: {', '.join(words)}"]
        if configuration is None and not machine.drives_place_it:
            message("pm3dof: the drives leave joints free: this is one of many poses, a near one")
    print_result(result, lines, as_json=as_json)
    if not solved.solved:
        message("pm3dof: the machine's own assembly mode does not exist at these commands, or is not reached from home")
        raise typer.Exit(LIMIT_BROKEN)
    stop_on_broken_limits(broken)


def _result(robot: Robot, poses: Poses) -> tuple[dict[str, Any], list[BrokenLimit]]:
    """Return the data of one pose, shape=(), and the limits it breaks; values are null where it was not solved."""
    configuration = poses.configuration() if poses.solved else None
    broken = [] if configuration is None else broken_limits(robot, configuration)
    units = {command.unit for command in robot.commands}
    result: dict[str, Any] = {
        "robot": robot.name,
        "u": poses.commands,
        "commands": names_and_units(robot.command_coordinates),
        **({f"u_{units.pop()}": poses.commands} if len(units) == 1 else {}),
        "pose": {c.name: value for c, value in zip(robot.coordinates, poses.coordinates, strict=True)},
        "coordinates": names_and_units(robot.coordinates),
        **with_units(robot.coordinates, poses.coordinates),
        "within_limits": configuration is not None and not broken,
        "violated": [limit.name for limit in broken],
        "joints": {},
        "swing_rad": {},
        "residual_m": poses.residual,
    }
    if configuration is not None:
        result["joints"] = _joints(configuration)
        result["swing_rad"] = {
            name: configuration.swing(index)
            for index, (loop, name) in enumerate(zip(robot.closures, closure_names(robot).values(), strict=True))
            if loop.swing_limit is not None
        }
    return result, broken


def _ik_lines(robot: Robot, result: dict[str, Any]) -> list[str]:
    rows = [
        [c["name"], *_reading(value, c["unit"], 9)] for c, value in zip(result["commands"], result["u"], strict=True)
    ]
    lines = table_lines(["command", "value", ""], rows)
    passive = [
        [name, *_reading(result["joints"][name], robot.single_joint(name).unit, 3)]
        for name in robot.passive_joints
        if name in result["joints"]
    ]
    passive += [[name, *_reading(angle, "rad", 3)] for name, angle in result["swing_rad"].items()]
    return [*lines, "", *table_lines(["passive joint", "position", ""], passive)] if passive else lines


def _reading(value: float, unit: str, digits: int) -> tuple[str, str]:
    """Return a value formatted in the unit of the command line (angles in degrees), and that unit."""
    factor, shown = shown_in(unit)
    return fixed(factor * value, max(digits, 6) if unit == "m" else digits), shown


def _pose_lines(coordinates: Sequence[Coordinate], poses: Sequence[Vector]) -> list[str]:
    header = [f"{c.name} [{shown_in(c.unit)[1]}]" for c in coordinates]
    digits = {"m": 12, "rad": 9}
    rows = [[_reading(v, c.unit, digits[c.unit])[0] for c, v in zip(coordinates, pose, strict=True)] for pose in poses]
    return table_lines(header, rows)


def _mode_lines(modes: Poses) -> list[str]:
    """Return a table of modes that coordinates do not tell apart: places of the tool, or else passive joints."""
    robot = modes.robot
    if robot.tool_frame is not None:
        columns = dict(zip(("x_m", "y_m", "z_m"), modes.positions.T.tolist(), strict=True))
        angles = np.degrees([tool_components(transform)[3:] for transform in modes.transforms])
        columns |= dict(zip(("rx_deg", "ry_deg", "rz_deg"), angles.T.tolist(), strict=True))
    else:
        joints = [_joints(pose) for pose in modes]
        passive = [name for name in robot.passive_joints if name in joints[0]][:_SHOWN_JOINTS]
        shown = [(name, *shown_in(robot.single_joint(name).unit)) for name in passive]
        columns = {f"{name}_{unit}": [factor * each[name] for each in joints] for name, factor, unit in shown}
    rows = [[fixed(value, 9) for value in row] for row in zip(*columns.values(), strict=True)]
    return table_lines(list(columns), rows)


def _joints(configuration: Configuration) -> dict[str, float]:
    """Return the coordinates of single-DoF joints [m, rad]."""
    model = configuration.mechanism.model
    singles = [name for name in list(model.names)[1:] if model.joints[model.getJointId(name)].nv == 1]
    return {name: configuration.joint_position(name) for name in singles}


def _completeness(modes: AssemblyModes) -> str:
    """Say how many modes random starts met, and how likely there are others; home's may be met by none of them."""
    met = [times for times in modes.counts if times]
    starts = f"{modes.starts:,} random starts"
    if not met:
        return f"home's assembly mode; none of {starts} closes the loops, so that nothing is known of others"
    beside = "" if len(met) == len(modes.counts) else ", and home's, which none of these met"
    found = f"{len(met)} assembly modes from {starts}{beside}"
    if modes.more:
        total = float(f"{modes.estimated:.2g}")
        return f"{found}; there are more, too many to find: at least about {total:,.0f} in all"
    if beside:
        return f"{found}; others as rarely met are likely to be missing"
    least = min(_TIMES, *met)
    return (
        f"{found}, each met at least {least} times; estimated number {modes.estimated:.3g}, and one as rarely met as "
        f"that is missing with a probability of {100.0 * math.exp(-least):.2g} %"
    )


def _found_modes(robot: Robot, commands: Vector) -> AssemblyModes:
    """Return the modes found from random starts; UnreachablePoseError if there is none."""
    found = assembly_modes(robot, commands, times=_TIMES)
    if not found.counts:
        values = with_units(robot.command_coordinates, commands)
        listed = first_words([f"{name} = {value:g}" for name, value in values.items()])
        raise UnreachablePoseError(f"no pose closes the loops at {listed}: none of {found.starts} random starts does")
    return found


def _all_modes(commands: Vector, tripod: Tripod) -> tuple[list[Vector], list[float]]:
    """Return every pose of the chapter's machine at the given commands, with the link length errors [m]."""
    modes = all_assembly_modes(tripod, commands)
    if not len(modes):
        travels = ", ".join(f"{travel:g}" for travel in commands)
        raise UnreachablePoseError(f"no pose closes the loops at u = ({travels}) m: there is no assembly mode")
    return list(modes), newton(tripod, commands, modes).residual.tolist()
