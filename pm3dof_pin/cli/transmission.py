"""`pm3dof transmission`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
import typer
from numpy.typing import ArrayLike

from pm3dof_pin.capability.serial_model import SerialModel, Spread, serial_model
from pm3dof_pin.capability.table import write_tables
from pm3dof_pin.capability.transmission import Transmission
from pm3dof_pin.cli.options import Json, PlaceOptions, RobotOptions, numbers_by_name
from pm3dof_pin.cli.output import fixed, message, print_result, table_lines
from pm3dof_pin.cli.pictures import Formats, PictureFormat, save
from pm3dof_pin.cli.poses import place
from pm3dof_pin.cli.transmission_options import TransmissionOptions
from pm3dof_pin.description.coordinates import shown_in
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Vector

JointGain: TypeAlias = Annotated[
    str | None, typer.Option(metavar="N|JOINT=N,..", help="A gain of the joints, whose gains at the drives are asked.")
]


_GAIN_KEYS = {"kp": "stiffness_N_m_rad", "kd": "damping_N_m_s_rad"}


def transmission(
    which: RobotOptions,
    chosen: PlaceOptions,
    options: TransmissionOptions,
    joint_kp: JointGain = None,
    joint_kd: JointGain = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the table over the box (CSV and NetCDF), pictures, and a page: what to type."),
    ] = None,
    formats: Formats = None,
    as_json: Json = False,
) -> None:
    """Say what a serial model must know of joints driven through closed loops: angles in degrees, lengths in metres.

    At a pose of the joints: the mapping between drives and joints, apparent inertia, torque and speed limits. Over the
    box of --over: the range of each, and the constant that is least wrong. Limits that are unknown are left out, and
    torques given in multiples of the drives' effort. Gains of the drives become gains of the joints with --gains; those
    of the joints become gains of the drives with --joint-kp and --joint-kd, a matrix, and its diagonal.
    """
    robot = options.part(which.load())
    gains = options.gains_of(robot)
    given = {"kp": joint_kp, "kd": joint_kd}
    wanted = {name: _joint_gains(robot, f"--joint-{name}", text) for name, text in given.items() if text}
    box = options.box(robot)
    at = options.at(place(robot, chosen))
    model = serial_model(box, **gains)
    result: dict[str, Any] = {}
    if as_json:  # vertices take long
        result = {"robot": robot.name} | _transmission_result(at, **gains) | _drive_gains_result(at, wanted)
        result["box"] = _serial_model_result(model) | _drive_gains_over(box, wanted)
    files = []
    if out is not None:
        functions = options.write_functions(robot, out)
        files = [*write_tables(box, out), *functions, *_write_report(model, box, out, formats, functions)]
    elif options.to:
        raise typer.BadParameter("--to needs a folder: --out DIR")
    lines = [*_lines(at), *_drive_gains_lines(at, wanted), "", *_box_lines(model)]
    print_result(result, lines, as_json=as_json, files=files)
    unknown = [name for name, spread in (("--effort", model.torque), ("--speed", model.speed)) if spread is None]
    if unknown:
        message(
            f"pm3dof: {' and '.join(unknown)}: not described; results that need them are left out, and torques are "
            "given by a drive's effort of 1"
        )


def _joint_gains(robot: Robot, option: str, text: str) -> Vector:
    """Return a gain of each joint; wrong usage ends the command with status 2."""
    given, names = numbers_by_name(option, text), [coordinate.name for coordinate in robot.coordinates]
    gains = given if isinstance(given, dict) else dict.fromkeys(names, given or 0.0)
    if set(gains) != set(names) or min(gains.values()) < 0.0:
        raise typer.BadParameter(f"{option} {text}: expected a number, not negative, for each of {', '.join(names)}")
    if len(robot.actuated_joints) != len(names):
        raise typer.BadParameter(f"{option}: expected as many drives as joints, not {len(robot.actuated_joints)}")
    return np.array([gains[name] for name in names])


def _drive_gains_result(at: Transmission, wanted: Mapping[str, Vector]) -> dict[str, Any]:
    """Return the drives' gains that give those of the joints, and what the diagonal alone gives the joints."""
    found = {}
    for name, gains in wanted.items():
        key, full = _GAIN_KEYS[name], at.drive_gains(gains)
        found[f"drive_{key}"] = full
        found[f"joint_{key}_of_diagonal"] = at.joint_gains(np.diag(full))
    return found


def _drive_gains_over(box: Transmission, wanted: Mapping[str, Vector]) -> dict[str, Any]:
    """Return the ends, over the box, of the diagonal of the drives' gains that give those of the joints."""
    within, found = box.poses.within_limits, {}
    for name, gains in wanted.items():
        spread = Spread.over(np.einsum("...ii->...i", box.drive_gains(gains))[within], "least")
        found[f"drive_{_GAIN_KEYS[name]}"] = {
            drive: {"least": float(low), "greatest": float(high)}
            for drive, low, high in zip(box.drives, spread.least, spread.greatest, strict=True)
        }
    return found


def _drive_gains_lines(at: Transmission, wanted: Mapping[str, Vector]) -> list[str]:
    lines = []
    for name, gains in wanted.items():
        full = _cleaned(at.drive_gains(gains))
        for words, names, matrix in (
            (f"{name} of the drives, for {name} of the joints", at.drives, full),
            (f"{name} of the joints by its diagonal alone", at.joints, _cleaned(at.joint_gains(np.diag(full)))),
        ):
            rows = [[each, *(f"{entry:.6g}" for entry in row)] for each, row in zip(names, matrix, strict=True)]
            lines += ["", *table_lines([words, *names], rows)]
    return lines


def _write_report(
    model: SerialModel, box: Transmission, out: Path, formats: list[PictureFormat] | None, functions: list[Path]
) -> list[Path]:
    """Write pictures and the page that answers what to type, with links to the mapping as functions."""
    from pm3dof_pin.figures.transmission import transmission_pictures
    from pm3dof_pin.figures.transmission_report import transmission_report

    pictures = transmission_pictures(box)
    files = [file for name, figure in pictures.items() for file in save(figure, out / f"{name}.png", formats)]
    links = [file.relative_to(out).as_posix() for file in functions]
    page = transmission_report(box.poses.robot.name, model, pictures, links)
    return [*files, write_text_atomically(out / "report.html", page)]


def _transmission_result(
    at: Transmission, *, kp: ArrayLike | None = None, kd: ArrayLike | None = None
) -> dict[str, Any]:
    """Return the transmission at one pose for JSON; keys end in their unit."""
    result: dict[str, Any] = {
        "joints": at.joints,
        "drives": at.drives,
        "pose_rad": at.poses.coordinates,
        "commands": at.poses.commands,
        "jacobian": at.jacobian,
        "jacobian_rate": at.jacobian_derivatives,
        "rotor_inertia_kg_m2": at.rotor_inertia,
        "inertia_kg_m2": at.inertia,
        "holding_torque_N_m": at.weight,
        "greatest_pure_torque_by_drive_effort": dict(zip(at.joints, at.unit_pure_torques, strict=True)),
        "distance_to_singularity": at.distance_to_singularity,
    }
    if np.isfinite(at.effort).all():
        result |= {
            "effort_N_m": at.effort,
            "greatest_pure_torque_N_m": dict(zip(at.joints, at.pure_torques, strict=True)),
            "greatest_torque_ball_N_m": at.torques.ball_radius,
            "greatest_torque_box_N_m": dict(zip(at.joints, at.torque_box, strict=True)),
            "torque_polytope_N_m": at.torques.vertices(),
            "torque_facets": {"normals": at.torques.normals, "offsets_N_m": at.torques.offsets},
        }
    if np.isfinite(at.speed).all():
        result |= {
            "speed_rad_s": at.speed,
            "greatest_pure_speed_rad_s": dict(zip(at.joints, at.pure_speeds, strict=True)),
            "speed_polytope_rad_s": at.speeds.vertices(),
            "speed_facets": {"normals": at.speeds.normals, "offsets_rad_s": at.speeds.offsets},
        }
    if kp is not None:
        result[f"joint_{_GAIN_KEYS['kp']}"] = at.joint_gains(kp)
    if kd is not None:
        result[f"joint_{_GAIN_KEYS['kd']}"] = at.joint_gains(kd)
    return result


def _serial_model_result(model: SerialModel) -> dict[str, Any]:
    """Return the constants of a serial model for JSON."""

    def spread(found: Spread) -> dict[str, Any]:
        columns = (found.least, found.greatest, found.least_wrong, found.error)
        keys = ("least", "greatest", "least_wrong", "relative_error")
        return {
            joint: dict(zip(keys, map(float, row), strict=True))
            for joint, *row in zip(model.joints, *columns, strict=True)
        }

    return {
        "lower_rad": model.lower,
        "upper_rad": model.upper,
        "share_out_of_reach": model.unreached,
        "reached_share_of_box": model.reached_scale,
        "distance_to_singularity": model.distance_to_singularity,
        "rotor_coupling": model.coupling,
        **{key: spread(found) for key, (_, _, found) in _quantities(model).items()},
    }


def _quantities(model: SerialModel) -> dict[str, tuple[str, tuple[str, str], Spread]]:
    """Return what a serial model is given: by key of JSON, its words, its units along and about an axis, its spread."""
    has_rotors = bool(model.armature.greatest.any())
    found: dict[str, tuple[str, tuple[str, str], Spread | None]] = {
        "rotor_inertia_kg_m2": ("armature (rotors)", ("kg", "kg m²"), model.armature if has_rotors else None),
        "inertia_kg_m2": ("inertia with links", ("kg", "kg m²"), model.inertia),
        "greatest_pure_torque_by_drive_effort": ("torque by a drive's effort", ("", ""), model.unit_torque),
        "greatest_pure_torque_N_m": ("torque beyond the weight", ("N", "N m"), model.torque),
        "effort_limit_N_m": ("torque, weight included", ("N", "N m"), model.effort),
        "greatest_pure_speed_rad_s": ("speed", ("m/s", "rad/s"), model.speed),
        "joint_stiffness_N_m_rad": ("kp", ("N/m", "N m/rad"), model.gains.get("kp")),
        "joint_damping_N_m_s_rad": ("kd", ("N s/m", "N m s/rad"), model.gains.get("kd")),
    }
    return {key: (words, units, spread) for key, (words, units, spread) in found.items() if spread is not None}


def _lines(at: Transmission) -> list[str]:
    rows = [[drive, *(fixed(entry, 6) for entry in row)] for drive, row in zip(at.drives, at.jacobian, strict=True)]
    lines = table_lines(["rates of drives by those of", *at.joints], rows)
    matrices = {"rotors felt": at.rotor_inertia, "inertia with moving links": at.inertia}
    for words, matrix in matrices.items():
        if matrix.any():
            entries = zip(at.joints, _cleaned(matrix), strict=True)
            rows = [[joint, *(f"{entry:.6g}" for entry in row)] for joint, row in entries]
            lines += ["", *table_lines([f"{words} [kg, m, rad]", *at.joints], rows)]
    limits = {"holds the weight": at.weight, "greatest torque by a drive's effort": at.unit_pure_torques}
    if np.isfinite(at.effort).all():
        limits |= {"greatest torque beyond the weight": at.pure_torques, "all joints at once": at.torque_box}
    if np.isfinite(at.speed).all():
        limits["greatest speed"] = at.pure_speeds
    rows = [
        [words, *(f"{entry:.6g}" if np.isfinite(entry) else "-" for entry in np.round(values, 9) + 0.0)]
        for words, values in limits.items()
    ]
    lines += ["", *table_lines(["limits [N, m, rad, s]", *at.joints], rows)]
    if len(at.joints) > 1:
        lines += ["", f"distance to singularity {at.distance_to_singularity:.3g}: least by greatest gain of the rates"]
    return lines


def _cleaned(matrix: Array) -> Array:
    """Return a matrix with entries of rounding set to zero."""
    diagonal = np.sqrt(np.abs(np.diag(matrix)))
    return np.where(np.abs(matrix) < 1e-12 * np.outer(diagonal, diagonal), 0.0, matrix)


def _box_lines(model: SerialModel) -> list[str]:
    ends = []
    for joint, low, high, unit in zip(model.joints, model.lower, model.upper, model.units, strict=True):
        factor, shown = shown_in(unit)
        ends.append(f"{joint} {factor * low:.4g} to {factor * high:.4g} {shown}")
    lines = [f"over {', '.join(ends)}"]
    if model.unreached:
        lines.append(
            f"{100.0 * model.unreached:z.1f} % of these poses are out of reach or beyond limits; none is in the box of "
            f"{model.reached_scale:z.2f} times the size about the same centre"
        )
    if len(model.joints) > 1:
        lines.append(f"distance to singularity {model.distance_to_singularity:.3g} or more")
    rows = []
    for words, units, spread in _quantities(model).values():
        columns = (spread.least, spread.greatest, spread.least_wrong, spread.error)
        for joint, unit, low, high, typed, error in zip(model.joints, model.units, *columns, strict=True):
            numbers = (f"{low:.4g}", f"{high:.4g}", f"{typed:.4g}", f"±{100.0 * error:z.0f} %")
            rows.append([words, joint, units[unit == "rad"], *numbers])
            words = ""
    lines += table_lines(["", "", "", "least", "greatest", "least wrong", "off by"], rows, words=3)
    if model.coupling:
        lines.append(f"rotors couple the joints by up to {100.0 * model.coupling:z.0f} % of their own inertia")
    return lines
