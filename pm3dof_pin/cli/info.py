"""`pm3dof info`."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from dataclasses import replace
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
import numpy as np
import pinocchio as pin
import typer

from pm3dof_pin.cli import completion
from pm3dof_pin.cli.options import Json, RobotOptions
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.cli.singularity_report import read_singularity_distances, singularity_line
from pm3dof_pin.description.closures import ClosuresSchema
from pm3dof_pin.description.coordinates import shown_in
from pm3dof_pin.description.description import Description
from pm3dof_pin.description.error_file import ErrorFileSchema
from pm3dof_pin.description.parameters import Parameter
from pm3dof_pin.description.robots import RobotFiles, example_robot_names, robot_names
from pm3dof_pin.elastic.springs import SPRING_SCHEMAS, read_springs
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import ConvergenceError, DescriptionError, InvalidValueError, PM3DofError
from pm3dof_pin.export.named_configurations import write_configuration
from pm3dof_pin.kinematics.assemblies import assembled_homes, closing_trial
from pm3dof_pin.kinematics.branches import branches_of, start_of
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.mobility import generic_configuration
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import CLOSED, RANK_GAP

_CLOSED = 1e-6  # greatest residual of a closed loop [m or rad]
_SHOWN = 8  # commands of an assembly

FileKind: TypeAlias = Literal["closures", "errors", "parameters"]
"""The YAML files of a robot."""

_KINDS = (("Free", "free"), ("Spherical", "spherical"), ("Composite", "composite"), ("Planar", "planar"))


def info(
    which: RobotOptions,
    path: Annotated[
        str | None, typer.Argument(metavar="ROBOT", help="Same as --robot.", autocompletion=completion.robots)
    ] = None,
    schema: Annotated[
        FileKind | None,
        typer.Option("--schema", help="Print the JSON Schema of a YAML file, for editors, and exit."),
    ] = None,
    assemble: Annotated[
        bool, typer.Option("--assemble", help="Write a configuration 'home' with closed loops into the robot's SRDF.")
    ] = False,
    branch: Annotated[
        int | None, typer.Option("--branch", help="Which of the assemblies that --assemble lists, from 1.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Summarize a robot: files, joints, commands, coordinates, loop closures, degrees of freedom, home.

    Works on any file that can be read, and says what is missing and what to try.
    """
    if schema is not None:
        print_result(_file_schema(schema), [], as_json=True)
        return
    which = replace(which, robot=path or which.robot)
    machine = which.load()
    files = machine.files
    assert files is not None
    if assemble or branch is not None:
        _assemble(machine, files, branch, as_json)
        return
    result = (
        _files(files)
        | _errors(files, machine)
        | _tree(machine)
        | _closures(machine)
        | _mobility(machine)
        | _reach(machine)
        | _readings(machine)
    )
    result |= _springs(machine) | _read_over(machine.description)
    result["named_configurations"] = list(machine.named_configurations)
    reason = machine.reason_without_programs(compiled=False)
    result |= {"engine": "program" if reason is None else "pinocchio", "engine_reason": reason}
    result["tool_motions"] = machine.tool_motions
    result["singularity_distances"] = read_singularity_distances(machine.home)
    result["missing"] = _missing(result, machine)
    result["robots"] = robot_names()
    result["example_robots"] = example_robot_names()
    print_result(result, _lines(result, machine), as_json=as_json)


def _file_schema(kind: FileKind) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a kind of file, generated from the types that check it on reading."""
    schema: type | None = {"closures": ClosuresSchema, "errors": ErrorFileSchema}.get(kind)
    schemas = [schema or Parameter, *(SPRING_SCHEMAS.values() if kind == "closures" else ())]
    (root, *springs), parts = msgspec.json.schema_components(schemas, ref_template="#/$defs/{name}")
    if kind == "parameters":  # the tripod's file: a name and other texts, and sections of parameters
        section = {"if": {"type": "object"}, "then": {"additionalProperties": root}}
        root = {"type": "object", "properties": {"name": {"type": "string"}}, "additionalProperties": section}
    if springs:
        parts["ClosuresSchema"]["properties"]["springs"] = {"type": "array", "items": {"oneOf": springs}}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": kind, **root, "$defs": parts}


def _files(files: RobotFiles) -> dict[str, Any]:
    return {
        "description": str(files.path),
        "format": files.format,
        "urdf": str(files.path) if files.format == "urdf" else None,
        "closures_file": str(files.closures) if files.closures is not None else None,
        "srdf": str(files.srdf) if files.srdf is not None else None,
        "errors_file": str(files.errors) if files.errors.is_file() else None,
    }


def _errors(files: RobotFiles, robot: Robot) -> dict[str, Any]:
    if not files.errors.is_file():
        return {"error_parameters": None}

    errors = GeometricErrors.from_file(robot, files.errors)
    return {"error_parameters": {group: len(errors.indices(group)) for group in errors.groups}}


def _tree(robot: Robot) -> dict[str, Any]:
    model = robot.model
    joints = list(zip(model.names, model.joints, model.inertias, strict=True))[1:]
    kinds = {name: _kind(robot, name, joint.shortname()) for name, joint, _ in joints}
    massless = [name for name, _, inertia in joints if inertia.mass == 0.0]
    return {
        "robot": robot.name,
        "name": robot.name,
        "joints": len(joints),
        "joint_types": dict(Counter(kinds.values())),
        "actuated_joints": robot.actuated_joints,
        "moving_mass_kg": float(sum(inertia.mass for _, _, inertia in joints)),
        "links_without_mass": [frame.name for frame in model.frames if _is_carried(model, frame, massless)],
        "impossible_inertias": dict(robot.impossible_inertias),
    }


def _kind(robot: Robot, name: str, shortname: str) -> str:
    for part, kind in _KINDS:
        if part in shortname:
            return kind
    return "prismatic" if robot.single_joint(name).translates else "revolute"


def _is_carried(model: Any, frame: Any, joints: list[str]) -> bool:
    """Tell whether a frame is the link that one of the joints carries."""
    if frame.type != pin.FrameType.BODY or model.names[frame.parentJoint] not in joints:
        return False
    return bool(model.frames[frame.parentFrame].type == pin.FrameType.JOINT)


def _closures(robot: Robot) -> dict[str, Any]:
    home, rows = robot.home, robot.loop_kinematics.rows
    residuals = [float(np.abs(home.closure_error[part]).max()) for part in rows]
    return {
        "closures": [
            {"frame_a": c.frame_a, "frame_b": c.frame_b, "type": c.type, "residual": residual}
            for c, residual in zip(robot.closures, residuals, strict=False)
        ],
        "couplings": [
            {"joint": c.joint, "joints": c.joints, "coefficients": c.coefficients, "offset": c.offset}
            for c in robot.couplings
        ],
        "closure_residual": home.closure_residual,
        "home_closure_residual": home.closure_residual,
        "closure_tolerance": robot.closure_tolerance,
        "tool_frame": robot.tool_frame,
        "home_tool_position_m": home.tool_placement.translation if robot.tool_frame is not None else None,
    }


def _mobility(robot: Robot) -> dict[str, Any]:
    """Count degrees of freedom at home, or near it if it is singular; all None if the loops are open."""
    keys = (
        *("mobility", "tool_mobility", "redundant_constraints", "free_degrees_of_freedom", "idle_degrees_of_freedom"),
        *("rank_gap", "mobility_at_home"),
    )
    try:
        dof = DegreesOfFreedom(robot.home)
    except InvalidValueError:
        return dict.fromkeys(keys)
    at_home = dof.count
    with contextlib.suppress(ConvergenceError, InvalidValueError):
        near = DegreesOfFreedom(generic_configuration(robot.home))
        dof = near if near.count != at_home else dof
    has_tool = robot.tool_frame is not None
    counts = (
        dof.count,
        dof.at_tool.rank.rank if has_tool else None,
        len(robot.home.closure_error) - dof.constraint_rank.rank,
        dof.count - dof.at_actuators.rank.rank,
        dof.count - dof.idle.rank.rank if has_tool else None,
        gap if math.isfinite(gap := dof.constraint_rank.gap) else None,
        at_home,
    )
    return dict(zip(keys, counts, strict=True))


def _reach(robot: Robot) -> dict[str, Any]:
    """Say what bounds the poses that are reached from home, and where they are reached from."""
    described = robot.described_home.closure_residual
    result: dict[str, Any] = {"described_home_closure_residual": described, "home_refused": None}
    try:
        start = start_of(robot)
    except PM3DofError as error:
        return result | {"branch_conditions": [], "start_is_home": False, "home_refused": str(error)}
    return result | {
        "branch_conditions": list(branches_of(robot).conditions),
        "start_is_home": bool(np.array_equal(start, robot.home.q)),
    }


def _reach_line(result: dict[str, Any], robot: Robot) -> list[str]:
    if not robot.has_branches or result["home_refused"]:
        return []
    bounds = result["branch_conditions"]
    words = f"poses are reached up to {' and '.join(bounds) or 'no'} singularities"
    if "parallel" not in bounds and robot.coordinates != robot.command_coordinates:
        many = len(robot.commands) > len(robot.coordinates)
        why = "there are no drives" if not robot.commands else "more drives than coordinates have no singularity"
        words += f" ({why if many or not robot.commands else 'the drives do not determine the coordinates'})"
    if not result["start_is_home"]:
        words += "; home is singular, so from the only side of it within limits"
    if result["described_home_closure_residual"] > _CLOSED:
        words += (
            f"; home is closed from a described one that is open by {result['described_home_closure_residual']:.2g}"
        )
    return [words]


def _imprecision(robot: Robot) -> str:
    usual = CLOSED * max(1.0, robot.characteristic_length)
    if not robot.has_loops or robot.closure_tolerance <= usual:
        return ""
    return f"; they count as closed to {robot.closure_tolerance:.2g} m or rad, as far as the description closes them"


def _assemble(robot: Robot, files: RobotFiles, branch: int | None, as_json: bool) -> None:
    """List the assemblies near the described home, and write as home the chosen one, or the only one within limits."""
    homes = assembled_homes(robot)
    if not robot.actuated_indices.size:
        message(f"pm3dof: {robot.name} has no drives (--drives): assemblies are told apart by the loops alone")
    joints = list(zip(robot.model.names, robot.model.joints, strict=True))[1:]
    names = [name for name, joint in joints if joint.nv == 1]
    entries = [
        {
            "branch": number,
            "distance": home.distance,
            "within_limits": home.within_limits,
            "singularity_distance": home.regularity,
            "joints": {name: home.configuration.joint_position(name) for name in names},
        }
        for number, home in enumerate(homes, start=1)
    ]
    rows = [
        [
            str(number),
            f"{home.distance:.3g}",
            f"{home.regularity:.2g}",
            "yes" if home.within_limits else "no",
            ", ".join(f"{value:.4g}" for value in home.configuration.commands[:_SHOWN]),
        ]
        for number, home in enumerate(homes, start=1)
    ]
    distances = ("from the described home [rad, sizes]", "from singular ones")
    lines = table_lines(["branch", *distances, "within limits", "commands [m, rad]"], rows)
    within = [number for number, home in enumerate(homes, start=1) if home.within_limits]
    if branch is None and len(within or homes) == 1:
        branch = (within or [1])[0]
    if branch is not None and not 1 <= branch <= len(homes):
        raise typer.BadParameter(f"--branch {branch}: there are {len(homes)}")
    path = files.srdf or files.path.parent / f"{files.name}.srdf"
    if branch is not None:
        write_configuration(path, "home", homes[branch - 1].configuration)
    written = None if branch is None else str(path)
    print_result({"robot": robot.name, "assemblies": entries, "written": written}, lines, as_json=as_json)
    if branch is None:
        message(f"pm3dof: {robot.name} has {len(homes)} assemblies near its described home: choose with --branch")
        raise typer.Exit(1)
    message(f"wrote configuration 'home' to {path}")


def _readings(robot: Robot) -> dict[str, Any]:
    """Return commands and coordinates with their ranges and home values."""
    poses = robot.at([robot.home.q])
    entries = {
        "commands": (robot.command_coordinates, poses.commands[0]),
        "coordinates": (robot.coordinates, poses.coordinates[0]),
    }
    result: dict[str, Any] = {
        key: [
            {"name": c.name, "unit": c.unit, "joint": c.joint, "tool": c.tool, "offset": c.offset, "scale": c.scale}
            | dict(zip(("lower", "upper", "home"), (*robot.range_of(c), float(value)), strict=True))
            for c, value in zip(coordinates, values, strict=True)
        ]
        for key, (coordinates, values) in entries.items()
    }
    ends = [entry[key] for entry in result["commands"] for key in ("lower", "upper")]
    return result | {"limits_given": any(map(math.isfinite, ends))}


def _springs(robot: Robot) -> dict[str, Any]:
    """Count the springs that can be used, or say why there are none."""
    try:
        return {"springs": len(read_springs(robot.springs, robot.source)), "springs_problem": None}
    except DescriptionError as error:
        return {"springs": 0, "springs_problem": str(error)}


def _read_over(description: Description) -> dict[str, Any]:
    """List the elements of the description that have no meaning here."""
    entries = [
        {"element": entry.element, "file": str(entry.origin.path), "line": entry.origin.line, "reason": entry.reason}
        for entry in description.unread
    ]
    return {"read_over": entries}


def _missing(result: dict[str, Any], robot: Robot) -> list[str]:
    """List what the description lacks and what to do about it."""
    remarks = []
    gaps = {f"{c['frame_a']}-{c['frame_b']}": c["residual"] for c in result["closures"]}
    if still_open := {name: gap for name, gap in gaps.items() if not gap <= max(_CLOSED, robot.closure_tolerance)}:
        listed = ", ".join(f"{name} by {gap:.3g} m or rad" for name, gap in still_open.items())
        remarks.append(
            f"loops are open at home: {listed}. They could not be closed from there, or in several ways; "
            f"{closing_trial(robot)}: define a configuration 'home' (SRDF or keyframe; pm3dof info --assemble), or "
            "check these frames and joints"
        )
    elif result["home_refused"]:
        remarks.append(result["home_refused"])
    elif beyond := robot.home.violated_limits():
        listed = ", ".join(f"{each.name} = {each.value:.4g} ({each.lower:.4g} .. {each.upper:.4g})" for each in beyond)
        remarks.append(
            f"home breaks limits: {listed} [m, rad]: define a configuration 'home' within them "
            "(SRDF or keyframe; pm3dof info --assemble finds some)"
        )
    if robot.tool_frame is None:
        remarks.append("no tool frame: name it with --tool-frame NAME, or as tool_frame in a closures file")
    if not robot.actuated_joints:
        remarks.append(
            "no actuated joints: name them with --drives JOINT,.., as name_mot in a closures file, or as actuators"
        )
    elif not result["limits_given"]:
        remarks.append("no limits are given for the actuated joints: they are treated as unlimited")
    if result["mobility"] is not None and len(robot.actuated_joints) > result["mobility"]:
        remarks.append(
            f"{len(robot.actuated_joints)} drives move {_counted(result['mobility'], 'degree')} of freedom: their "
            "commands must agree; if some of these joints have no motor, name the driven ones with --drives JOINT,.., "
            "or as name_mot in a closures file"
        )
    if free := result["free_degrees_of_freedom"]:
        idle = result["idle_degrees_of_freedom"]
        of_these = f"; {idle} of these do not move the tool (such as a rod spinning about its own axis)" if idle else ""
        remarks.append(f"mobility with the drives locked: {free}{of_these}")
    if result["springs_problem"]:
        remarks.append(f"the springs cannot be used: {result['springs_problem']}")
    elif not robot.springs:
        remarks.append("no springs: for stiffness, --drive-stiffness K, or springs in a closures file")
    if result["errors_file"] is None:
        remarks.append(
            "no error file: error maps and calibration use every geometric error of every joint; "
            "pm3dof error-parameters writes one"
        )
    if result["links_without_mass"]:
        remarks.append(
            f"links without mass: {', '.join(result['links_without_mass'])}: kinematics works, but "
            "simulators reject such links if they move"
        )
    remarks += [
        f"link {name}, with everything fixed to it: {problem}: modes and inverse dynamics are unavailable"
        for name, problem in result["impossible_inertias"].items()
    ]
    return remarks


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _lines(result: dict[str, Any], robot: Robot) -> list[str]:
    names = {"coordinates": "coordinate", "commands": "command"}
    if result["coordinates"] == result["commands"]:
        names = {"commands": "coordinate and command"}
    kinds = ", ".join(f"{count} {kind}" for kind, count in result["joint_types"].items())
    lines = [
        f"{result['name']}: {_counted(result['joints'], 'joint')} ({kinds}), "
        f"{len(result['actuated_joints'])} of them actuated, {_counted(len(result['closures']), 'loop closure')}"
    ]
    if result["mobility"] is None:
        lines.append("mobility unknown: the loops are open at home")
    else:
        of_tool = f" ({result['tool_mobility']} of the tool)" if result["tool_mobility"] is not None else ""
        redundant = _counted(result["redundant_constraints"], "redundant constraint")
        lines.append(f"mobility {result['mobility']}{of_tool}, {redundant}")
    if result["mobility_at_home"] != result["mobility"]:
        lines.append(f"mobility {result['mobility_at_home']} at home, a singular pose: the counts are those near it")
        if result["rank_gap"] is not None and result["rank_gap"] < RANK_GAP:
            lines[-1] += f", a borderline count: singular values fall by {result['rank_gap']:z.0f} only"
    lines += _reach_line(result, robot)
    lines += singularity_line(result["singularity_distances"])
    if result["tool_frame"] is not None:
        x, y, z = (round(value, 6) + 0.0 for value in result["home_tool_position_m"])  # no minus sign on zero
        lines.append(f"tool {result['tool_frame']}, at home x = {x:z.6f}, y = {y:z.6f}, z = {z:z.6f} m")
    closures = ", ".join(f"{c['frame_a']}-{c['frame_b']} ({c['type']})" for c in result["closures"])
    couplings = ", ".join(coupling.name for coupling in robot.couplings)
    counted = ", ".join(f"{count} {group}" for group, count in (result["error_parameters"] or {}).items())
    lines += [
        f"closures: {closures or 'none'}, residual at home {result['closure_residual']:.1e}{_imprecision(robot)}",
        *([f"couplings: {couplings}"] if couplings else []),
        f"moving mass {result['moving_mass_kg']:z.4f} kg, {_counted(result['springs'], 'spring')}",
        "many poses: compiled programs"
        if result["engine_reason"] is None
        else f"many poses: Pinocchio, one by one; there is no compiled program: {result['engine_reason']}",
        f"description {result['description']}",
        *(
            f"{key.replace('_', ' ').replace('srdf', 'SRDF')} {result[key]}"
            for key in ("closures_file", "srdf", "errors_file")
            if result[key] is not None
        ),
        *([f"error parameters: {counted}"] if counted else []),
        f"named configurations: {', '.join(result['named_configurations']) or 'none'}",
        *_read_over_lines(result["read_over"]),
        *result["missing"],
        f"robots that come with the package: {', '.join(result['robots'])}",
        "",
        *table_lines(
            ["", "", "lower", "upper", "home", "unit"],
            [
                [entry["name"], kind, *_in_degrees(entry["unit"], *(entry[key] for key in ("lower", "upper", "home")))]
                for key, kind in names.items()
                for entry in result[key]
            ],
        ),
        "",
    ]
    rows = [
        [
            name,
            "actuated" if name.partition("[")[0] in robot.actuated_joints else "passive",
            *(f"{limits[index]:.4g}" for limits in (robot.lower_limits, robot.upper_limits)),
        ]
        for index, name in enumerate(robot.q_names)
    ]
    return lines + table_lines(["joint", "", "lower [m, rad]", "upper [m, rad]"], rows)


def _read_over_lines(entries: list[dict[str, Any]]) -> list[str]:
    """Say what was read over, elements of one kind together, with the line of the first."""
    kinds: dict[tuple[str, str], list[Any]] = {}
    for entry in entries:
        tag = entry["element"].partition(" ")[0].rstrip(">") + ">" if entry["reason"] in ("", "unknown") else ""
        kinds.setdefault((tag or entry["element"], entry["reason"]), []).append(entry["line"])
    parts = []
    for (element, reason), lines in kinds.items():
        count = f"{len(lines)} x " if len(lines) > 1 else ""
        at = "" if lines[0] is None else f" (line {lines[0]})"
        parts.append(f"{count}{element}{at}" + (f": {reason}" if reason else ""))
    return [f"read over: {'; '.join(parts)}"] if parts else []


def _in_degrees(unit: str, *values: float) -> list[str]:
    """Format values for display: angles in degrees, "-" where there is no value."""
    factor, shown = shown_in(unit)
    return [*(f"{round(factor * value, 9) + 0.0:.6g}" if math.isfinite(value) else "-" for value in values), shown]
