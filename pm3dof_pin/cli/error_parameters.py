"""`pm3dof error-parameters`, and the error parameters that other commands use."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
import typer

from pm3dof_pin.cli.options import Json, RobotOptions
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.description.error_file import ErrorEntry, error_file_text, read_error_file
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.errors.error_parameters import GeometricErrors, GeometricParameter, all_parameters
from pm3dof_pin.errors.minimal_parameters import error_entries, minimal_parameters, poses_needed
from pm3dof_pin.errors.presets import preset
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

PresetName: TypeAlias = Literal[
    "complete", "dh", "zeros-only", "firmware-delta-6", "firmware-delta-7", "firmware-delta-9"
]
"""Sets of error parameters by name."""
ProcessName: TypeAlias = Literal["fine", "medium", "coarse", "very-coarse"]
"""Classes of ISO 2768-1."""

_SHOWN = 10
_LISTED = 3


def error_parameters(
    which: RobotOptions,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the minimal complete set to an error file, for editing."),
    ] = None,
    preset: Annotated[
        PresetName | None,
        typer.Option(help="Write a set by name to --out instead: as people parametrise machines."),
    ] = None,
    process: Annotated[
        ProcessName | None,
        typer.Option(help="Tolerances of parts by their size, as ISO 2768-1 has them; with --preset complete or dh."),
    ] = None,
    as_json: Json = False,
) -> None:
    """List a robot's geometric errors and find a minimal complete set of error parameters.

    The set is the smallest with the same effect on the tool as all errors of joints, closures and the tool. Parameters
    that the robot's error file declares come first.
    """
    if preset is not None:
        _write_preset(which, preset, process, out, as_json=as_json)
        return
    if process is not None:
        raise typer.BadParameter("--process needs --preset complete or --preset dh")
    file = find_robot(which.path, which.package_path or ()).errors
    loaded = GeometricErrors.from_file(which.load(), file)
    declared = loaded if file.is_file() else None
    given = declared.parameters if declared is not None else ()
    first = [parameter for parameter in given if isinstance(parameter, GeometricParameter)]
    named = {parameter.name for parameter in first}
    others = [parameter for parameter in all_parameters(loaded.robot) if parameter.name not in named]
    everything = GeometricErrors(loaded.robot, [*first, *others])
    poses = reachable_poses(loaded.robot, poses_needed(loaded.robot), np.random.default_rng(0))
    found = minimal_parameters(everything, poses, first=named)
    entries = error_entries(found)
    result: dict[str, Any] = {
        "robot": loaded.robot.name,
        "poses": len(poses),
        "candidates": len(everything),
        "parameters": [
            {
                "name": parameter.name,
                "class": parameter.group,
                "unit": parameter.unit,
                "tolerance": parameter.tolerance,
                "declared": parameter.name in named,
            }
            for parameter in found.parameters
        ],
        "declared": None if declared is None else len(declared),
        "missing": [] if declared is None else [name for name in found.names if name not in named],
        "redundant": [] if declared is None else [name for name in declared.names if name not in found.names],
        "errors_file": str(file) if declared is not None else None,
    }
    if out is not None:
        title = f"Geometric errors of {loaded.robot.name}, for error maps and calibration: {len(found)} parameters"
        comment = (
            f"{title}, minimal and complete.\n"
            "Directions are in each joint's or frame's own axes: x, y, z; along the joint axis, across it.\n"
            "Tolerances are standard deviations: set them for your machine."
        )
        zeros = read_error_file(file).command_zeros if declared is not None else {}
        write_text_atomically(out, error_file_text(entries, comment=comment, command_zeros=zeros))
        result["file"] = str(out)
    print_result(result, _described(result, entries), as_json=as_json)


def _write_preset(
    which: RobotOptions, name: PresetName, process: ProcessName | None, out: Path | None, *, as_json: bool
) -> None:
    if out is None:
        raise typer.BadParameter("--preset needs --out: the error file to write")
    robot = which.load()
    entries, ties = preset(robot, name, process)
    made = "" if process is None else f", parts made to ISO 2768-1, {process}"
    comment = (
        f"Geometric errors of {robot.name}, for calibration: preset {name}{made}.\n"
        "Directions are in each joint's or frame's own axes. Tolerances are standard deviations: set them for your "
        "machine."
    )
    write_text_atomically(out, error_file_text(entries, comment=comment, command_zeros={}, ties=ties))
    errors = GeometricErrors.from_file(robot, out)
    parameters = [
        {"name": p.name, "class": p.group, "unit": p.unit, "tolerance": p.tolerance} for p in errors.parameters
    ]
    result = {"robot": robot.name, "preset": name, "parameters": parameters, "file": str(out)}
    lines = [f"{robot.name}: {len(errors)} parameters, preset {name}{made}", f"wrote {out}"]
    print_result(result, lines, as_json=as_json)


def _described(result: dict[str, Any], entries: Sequence[ErrorEntry]) -> list[str]:
    count = len(result["parameters"])
    lines = [
        f"{result['robot']}: {count} error parameters have the same effect on the tool as all {result['candidates']} "
        f"errors of joints, closures and tool, at {result['poses']} poses"
    ]
    if result["declared"] is None:
        lines.append("no error file: error maps and calibration use all of them")
    else:
        lines.append(f"{result['errors_file']} declares {result['declared']}")
        for key, text in (("missing", "missing there"), ("redundant", "redundant")):
            if result[key]:
                lines.append(f"{text}: {', '.join(result[key])}")
    rows = [
        [
            *(_places(e.places), e.group, " ".join(e.translations) or "-", " ".join(e.rotations) or "-"),
            *(f"{e.length_tolerance * 1e6:.6g} µm", f"{e.angle_tolerance * 1e6:.6g} µrad"),
        ]
        for e in entries
    ]
    lines += ["", *table_lines(["place", "class", "translation", "rotation", "of length", "of angle"], rows)]
    return [*lines, *([f"wrote {result['file']}"] if "file" in result else [])]


def _places(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= _LISTED else f"{names[0]}, {names[1]} ... {names[-1]} ({len(names)})"


def closing_errors(errors: GeometricErrors, poses: Poses | None = None) -> GeometricErrors:
    """Return the errors that let the loops close at the poses (random by default), and report how many are dropped."""
    fitting = closable(errors, poses)
    report_dropped(errors, fitting)
    return fitting


def report_dropped(errors: GeometricErrors, fitting: GeometricErrors) -> None:
    """Report how many errors are dropped since the loops cannot close with them."""
    dropped = [name for name in errors.names if name not in fitting.names]
    if dropped:
        some = ", ".join(dropped[:_SHOWN]) + (" ..." if len(dropped) > _SHOWN else "")
        message(f"pm3dof: {len(dropped)} parameters are left out because the loops cannot close with them: {some}")
