"""`pm3dof receptance`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pm3dof_pin.cli.options import (
    Json,
    MachineOptions,
    Payload,
    PoseOptions,
    finite_number,
    numbers_by_name,
    payloads_of,
)
from pm3dof_pin.cli.output import message, table_lines
from pm3dof_pin.cli.pictures import Formats, save
from pm3dof_pin.cli.poses import column_of, print_at_pose, solve_chosen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.damping import LOSS_FACTOR, Damping
from pm3dof_pin.dynamics.dynamic_stiffness import RIGID, dynamic_stiffness
from pm3dof_pin.dynamics.receptance import VibratingSystem, vibrating_system
from pm3dof_pin.dynamics.servo_loop import GAIN_MARGIN, ServoLimit, servo_limits
from pm3dof_pin.dynamics.stability_lobes import Cutting, StabilityLobes, stability_lobes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import FreeDirectionError, InvalidValueError
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Matrix, Vector

_SPEED_COUNT = 400
_WORDS = {"direction": ("up", "down"), "plane": ("xy", "yx", "xz", "zx", "yz", "zy")}
_BASE = {f"base:{axis}": row for row, axis in enumerate("xyz")}
_SHOWN_SHARES = 3
_MIN_LOSS = 1e-6  # of a mode, by which the heights of peaks are compared

SourceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--from",
        metavar="FRAME:AXIS|JOINT",
        help="Where a force or torque acts: axis x, y, z, rx, ry or rz of a frame (`tool` is the tool's), or along a "
        "single-DoF joint; `base:x` is an acceleration of the base. May be repeated; the tool's six by default.",
    ),
]
OutputOption = Annotated[
    list[str] | None,
    typer.Option("--to", metavar="FRAME:AXIS|JOINT", help="What moves; what the force acts on by default."),
]


def receptance(
    chosen: PoseOptions,
    which: MachineOptions,
    sources: SourceOption = None,
    outputs: OutputOption = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Frequencies [Hz]; by default from a tenth of the first mode on."),
    ] = None,
    count: Annotated[int, typer.Option(min=2, help="Number of frequencies in the band, besides those at modes.")] = 400,
    loss_factor: Annotated[
        str | None,
        typer.Option(
            metavar="ETA|SPRING=ETA,..", help=f"Loss factor of springs that declare none, or of some ({LOSS_FACTOR})."
        ),
    ] = None,
    servo_bandwidth: Annotated[
        str | None,
        typer.Option(
            metavar="HZ|JOINT=HZ,..",
            help="Bandwidth of the drives' position loops [Hz]: their springs damp like servos instead of like metal.",
        ),
    ] = None,
    cutting: Annotated[
        str | None,
        typer.Option(
            metavar="KEY=VALUE,..",
            help="Depth limits of a cut: kc [N/m^2], kr, teeth (0 for turning), ae (part of the diameter), ap [m], "
            "direction (up, down), plane (xy, ..: feed and normal to it; turning: normal and cutting speed).",
        ),
    ] = None,
    speeds: Annotated[
        tuple[float, float], typer.Option(metavar="LOW HIGH", help="Spindle speeds for --cutting [1/min].")
    ] = (1000.0, 20000.0),
    payload: Payload = 0.0,
    folder: Annotated[Path | None, typer.Option(help="Folder for the curves (CSV) and pictures.")] = None,
    formats: Formats = None,
    as_json: Json = False,
) -> None:
    """Compute how far points move per oscillating force at a pose: angles in degrees, lengths in metres.

    For each pair of points: stiffness at rest, least dynamic stiffness and its frequency, most negative real part, and
    the modes that contribute; for each drive with a spring, the gain at which its position loop becomes unstable. With
    --cutting, the depth below which turning or milling does not chatter. Springs without a declared loss factor have
    that of --loss-factor, an assumption.
    """
    machine = which.load()
    model, payloads = ElasticModel(machine), payloads_of(machine, payload)
    damping = _damping(machine, model, loss_factor, servo_bandwidth)
    cut = None if cutting is None else _cutting(cutting)
    if not 0.0 < speeds[0] < speeds[1]:
        raise typer.BadParameter("--speeds: expected two increasing, positive speeds [1/min]")
    if band is not None and not 0.0 < band[0] < band[1]:
        raise typer.BadParameter("--band: expected two increasing, positive frequencies [Hz]")
    options: Any = {"damping": damping, "payloads": payloads}
    turns = np.linspace(*speeds, _SPEED_COUNT) / 60.0

    def columns(poses: Poses) -> dict[str, Array]:
        return _columns(model, poses, cut, options)

    if (pose := solve_chosen(machine, chosen, columns, as_json)) is None:
        return
    system = vibrating_system(model, pose.configuration(), **options)
    pairs = _pairs(sources, outputs)
    frequencies = _frequencies(system, pairs, band, count)
    curves = {
        pair: (curve, _unit(machine, pair))
        for pair, curve in zip(pairs, _curves(system, frequencies, pairs), strict=True)
    }
    results = [_of_pair(system, pair, frequencies, *curves[pair]) for pair in pairs]
    result: dict[str, Any] = {
        "payload_kg": payload,
        "natural_frequency_Hz": system.frequencies[np.isfinite(system.frequencies)],
        "assumed_loss_factor": damping.loss_factor,
        "receptances": results,
    }
    lines = _lines(results)
    # a spring that is itself a servo says nothing of the structure behind one
    driven = {spring.joint for spring in model.springs if isinstance(spring, JointSpring)} - set(damping.bandwidths)
    drives = [name for name in machine.actuated_joints if name in driven]
    if drives:
        limits = servo_limits(system, drives)
        result["servo"] = [
            {
                "drive": limit.drive,
                "critical_gain_per_s": limit.critical_gain,
                "critical_frequency_Hz": limit.critical_frequency,
                "bandwidth_Hz": limit.bandwidth,
            }
            for limit in limits
        ]
        lines += ["", *_servo_lines(limits)]
    lobes = None
    if cut is not None:
        lobes = stability_lobes(system, cut, turns)
        result["cutting"] = _lobes_result(lobes)
        lines += ["", *_lobes_lines(lobes)]
    if as_json:
        result["frequency_Hz"] = frequencies
    moving = {
        pair: curves[pair] for pair, entry in zip(pairs, results, strict=True) if entry["mode_shares"] is not None
    }
    files = [] if folder is None else _write(folder, machine, frequencies, moving, lobes, formats)
    if files:
        result["files"] = list(map(str, files))
    for file in files:
        message(f"wrote {file}")
    print_at_pose(pose, result, lines, as_json=as_json)


def _servo_lines(limits: Sequence[ServoLimit]) -> list[str]:
    rows = [
        [limit.drive, f"{limit.critical_gain:z.1f}", f"{limit.critical_frequency:z.1f}", f"{limit.bandwidth:z.1f}"]
        for limit in limits
    ]
    header = ["position loop", "unstable from K_v [1/s]", "at [Hz]", f"bandwidth, margin {GAIN_MARGIN:g} [Hz]"]
    return table_lines(header, rows)


def _damping(robot: Robot, model: ElasticModel, loss_factor: str | None, bandwidth: str | None) -> Damping:
    losses = numbers_by_name("--loss-factor", loss_factor)
    bandwidths = numbers_by_name("--servo-bandwidth", bandwidth)
    if isinstance(bandwidths, float):
        driven = {spring.joint for spring in model.springs if isinstance(spring, JointSpring)}
        bandwidths = {name: bandwidths for name in robot.actuated_joints if name in driven}
        if not bandwidths:
            raise typer.BadParameter(f"--servo-bandwidth: no drive of {robot.name} has a spring at its joint")
    common = losses if isinstance(losses, float) else LOSS_FACTOR
    named = losses if isinstance(losses, dict) else {}
    return Damping(loss_factor=common, loss_factors=named, bandwidths=bandwidths or {})


def _cutting(text: str) -> Cutting:
    """Read KEY=VALUE,.. ; wrong usage ends the command with status 2."""
    kinds = {field.name: field.type for field in fields(Cutting)}
    given: dict[str, Any] = {}
    for entry in text.split(","):
        key, _, value = (part.strip() for part in entry.partition("="))
        if key not in kinds or not value:
            raise typer.BadParameter(f"--cutting {entry}: expected KEY=VALUE with one of {', '.join(kinds)}")
        given[key] = value if key in _WORDS else finite_number(value)
        if key in _WORDS and value not in _WORDS[key]:
            raise typer.BadParameter(f"--cutting {entry}: expected one of {', '.join(_WORDS[key])}")
    if "kc" not in given:
        raise typer.BadParameter("--cutting: kc is missing, the cutting force per area of the chip [N/m^2]")
    if not float(given.setdefault("teeth", 0)).is_integer():
        raise typer.BadParameter("--cutting: teeth is a whole number")
    return Cutting(**given | {"teeth": int(given["teeth"])})


def _pairs(sources: list[str] | None, outputs: list[str] | None) -> list[tuple[str, str]]:
    """Return (to, from) of each receptance."""
    if sources is None and outputs is None:
        return [(f"tool:{component}", f"tool:{component}") for component in TOOL_COMPONENTS]
    if outputs is None:
        assert sources is not None
        return [("tool" + point[4:] if point in _BASE else point, point) for point in sources]
    for to in _BASE.keys() & set(outputs):
        raise InvalidValueError("--to", to, "a frame or joint that moves relative to the base")
    return [(to, point) for to in outputs for point in (sources or outputs)]


def _rows(system: VibratingSystem, point: str) -> Matrix:
    if point in _BASE:
        rows: Matrix = system.base_rows()[[_BASE[point]]]
        return rows
    return system.rows([point])


def _curves(system: VibratingSystem, frequencies: Vector, pairs: Sequence[tuple[str, str]]) -> list[Array]:
    outputs, inputs = (list(dict.fromkeys(points)) for points in zip(*pairs, strict=True))
    rows = np.vstack([_rows(system, point) for point in inputs])
    found = system.receptance(frequencies, system.rows(outputs), rows)
    return [found[:, outputs.index(to), inputs.index(source)] for to, source in pairs]


def _frequencies(
    system: VibratingSystem, pairs: Sequence[tuple[str, str]], band: tuple[float, float] | None, count: int
) -> Vector:
    """Return frequencies [Hz]: by default up to beyond the mode that gives each pair its highest peak."""
    around = system.frequencies_around_modes()
    if band is None:
        finite = system.frequencies[np.isfinite(system.frequencies)]
        if not len(finite):
            raise InvalidValueError("the robot's masses", problem="are all zero", expected="bodies with mass")
        losses, times = (np.diagonal(part)[: len(finite)] for part in (system.structural, system.viscous))
        losses = np.maximum(losses + 2.0 * np.pi * finite * times, _MIN_LOSS)
        highest = [min(len(finite), len(TOOL_COMPONENTS)) - 1]
        for to, source in pairs:
            if not _is_fixed(system, to):
                peaks = (system.rows([to])[0] @ system.shapes) * (_rows(system, source)[0] @ system.shapes)
                highest.append(int(np.argmax(np.abs(peaks[: len(finite)]) / losses)))
        band = (0.1 * float(finite[0]), 1.5 * float(finite[max(highest)]))
    inside = around[(around > band[0]) & (around < band[1])]
    frequencies: Vector = np.union1d(np.geomspace(*band, count), inside)
    return frequencies


def _is_angle(robot: Robot, point: str) -> bool:
    if ":" in point:
        return point.rpartition(":")[2].startswith("r")
    return not robot.single_joint(point).translates


def _unit(robot: Robot, pair: tuple[str, str]) -> str:
    moved = "rad" if _is_angle(robot, pair[0]) else "m"
    if pair[1] in _BASE:
        return f"{moved}/(m/s^2)"
    return f"{moved}/(N m)" if _is_angle(robot, pair[1]) else f"{moved}/N"


def _inverse_unit(unit: str) -> str:
    return {"m/N": "N/m", "rad/(N m)": "N m/rad", "rad/N": "N/rad", "m/(N m)": "N m/m"}.get(unit, f"1/({unit})")


def _of_pair(
    system: VibratingSystem, pair: tuple[str, str], frequencies: Vector, curve: Array, unit: str
) -> dict[str, Any]:
    at, lowest = int(np.abs(curve).argmax()), int(curve.real.argmin())
    output, source = system.rows([pair[0]])[0], _rows(system, pair[1])[0]
    parts = system.shares(float(frequencies[at]), output, source)
    size = np.linalg.norm(output @ system.shapes) * np.linalg.norm(source @ system.shapes)
    is_rigid = abs(curve[at]) <= SOLVED * size or (size > 0.0 and _is_fixed(system, pair[0]))
    static: float | None = None
    with suppress(FreeDirectionError):
        rest = system.receptance([0.0], output[None], source[None])[0, 0, 0].real
        static = 1.0 / rest if abs(rest) > SOLVED * abs(curve[at]) and not is_rigid else None
    return {
        "to": pair[0],
        "from": pair[1],
        "unit": unit,
        "static_stiffness": static,
        "dynamic_stiffness_minimum": None if is_rigid else 1.0 / abs(curve[at]),
        "critical_frequency_Hz": None if is_rigid else frequencies[at],
        "negative_real_part": 0.0 if is_rigid else min(float(curve.real.min()), 0.0),
        "negative_real_part_frequency_Hz": None if is_rigid else frequencies[lowest],
        "mode_shares": None if is_rigid else (parts * curve[at].conj()).real / abs(curve[at]) ** 2,
        "real": curve.real,
        "imaginary": curve.imag,
    }


def _is_fixed(system: VibratingSystem, point: str) -> bool:
    """Tell whether no spring lets a point move in its direction, as far as rounding tells."""
    frame, separator, component = point.rpartition(":")
    if not separator:
        return not np.any(system.rows([point]) @ system.shapes)
    sizes = np.linalg.norm(system.rows([f"{frame}:{axis}" for axis in TOOL_COMPONENTS]) @ system.shapes, axis=1)
    return bool(sizes[TOOL_COMPONENTS.index(component)] <= RIGID * sizes.max())


def _lines(results: list[dict[str, Any]]) -> list[str]:
    rows = []
    for entry in results:
        if entry["mode_shares"] is None:
            word = "rigid" if entry["to"] == entry["from"] else "none"
            rows.append([f"{entry['to']} / {entry['from']}", word, *[""] * 6])
            continue
        order = np.argsort(-np.abs(entry["mode_shares"]))[:_SHOWN_SHARES]
        shares = [f"{k + 1}: {100.0 * entry['mode_shares'][k]:z.0f} %" for k in order]
        static = entry["static_stiffness"]
        rows.append(
            [
                f"{entry['to']} / {entry['from']}",
                "-" if static is None else f"{static:.5g}",
                f"{entry['dynamic_stiffness_minimum']:.5g}",
                _inverse_unit(entry["unit"]),
                f"{entry['critical_frequency_Hz']:z.2f}",
                f"{entry['negative_real_part']:.4g}",
                entry["unit"],
                ", ".join(share for share in shares if not share.endswith((" 0 %", "-0 %"))),
            ]
        )
    header = ["to / from", "static", "least", "", "at [Hz]", "least Re G", "", "modes there"]
    return table_lines(header, rows)


def _lobes_result(lobes: StabilityLobes) -> dict[str, Any]:
    finite = np.isfinite(lobes.depth_limit)
    result: dict[str, Any] = {
        "depth_limit_m": lobes.depth_limit if finite else None,
        "chatter_frequency_Hz": lobes.chatter_frequency if finite else None,
        "speed_1_per_min": 60.0 * lobes.speeds,
        "depth_at_speed_m": [float(depth) if np.isfinite(depth) else None for depth in lobes.depths],
    }
    if lobes.is_stable is not None:
        result["stable_at_speed"] = lobes.is_stable.tolist()
    return result


def _lobes_lines(lobes: StabilityLobes) -> list[str]:
    kind = f"milling, {lobes.cutting.teeth} teeth" if lobes.cutting.teeth else "turning"
    if not np.isfinite(lobes.depth_limit):
        return [f"{kind}: no depth chatters"]
    limit, frequency = 1e3 * lobes.depth_limit, lobes.chatter_frequency
    lines = [f"{kind}: stable at every speed below {limit:.4g} mm; above, it chatters at {frequency:z.1f} Hz"]
    best = int(np.argmax(lobes.depths))
    if np.isfinite(lobes.depths[best]):
        lines.append(f"deepest at {60.0 * lobes.speeds[best]:z.0f} 1/min: {1e3 * lobes.depths[best]:.4g} mm")
    if lobes.is_stable is not None and lobes.cutting.ap is not None:
        share = 100.0 * float(np.mean(lobes.is_stable))
        lines.append(f"ap = {1e3 * lobes.cutting.ap:g} mm is stable at {share:z.0f} % of the speeds")
    return lines


def _columns(model: ElasticModel, poses: Poses, cut: Cutting | None, options: Any) -> dict[str, Array]:
    """Return columns for a file of poses."""
    found = dynamic_stiffness(model, poses, on_failure="nan", **options)
    columns: dict[str, Array] = {}
    for k, axis in enumerate(TOOL_COMPONENTS):
        unit = "N m/rad" if axis.startswith("r") else "N/m"
        columns[column_of(f"dynamic_stiffness_{axis}", unit.replace("/", "_per_"))] = found.minimum[:, k]
        columns[column_of(f"critical_frequency_{axis}", "Hz")] = found.critical_frequency[:, k]
    if cut is not None:
        depths = np.full(len(poses), np.nan)
        for row in np.flatnonzero(poses.solved):
            depths[row] = stability_lobes(vibrating_system(model, poses.q[row], **options), cut, [1.0]).depth_limit
        columns["depth_limit_m"] = depths
    return columns


def _write(
    folder: Path,
    robot: Robot,
    frequencies: Vector,
    curves: dict[tuple[str, str], tuple[Array, str]],
    lobes: StabilityLobes | None,
    formats: Any,
) -> list[Path]:
    """Write the curves and pictures; return the files."""
    from pm3dof_pin.figures.receptance import lobes_diagram, receptance_curves  # it loads matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    header = ["frequency_Hz"]
    parts: list[Array] = [frequencies]
    for (to, source), (curve, unit) in curves.items():
        header += [f"{part} {to} / {source} [{unit}]" for part in ("real", "imaginary")]
        parts += [curve.real, curve.imag]
    rows = [header, *np.column_stack(parts).tolist()]
    files = [write_text_atomically(folder / "receptance.csv", csv_text(rows))]
    named = {f"{to} / {source}": values for (to, source), values in curves.items()}
    if named:
        files += save(receptance_curves(robot.name, frequencies, named), folder / "receptance", formats)
    if lobes is not None and np.isfinite(lobes.depth_limit):
        speeds, depths = 60.0 * lobes.speeds, lobes.depths
        table = [["speed_1_per_min", "depth_m"], *np.column_stack([speeds, depths]).tolist()]
        files.append(write_text_atomically(folder / "lobes.csv", csv_text(table)))
        files += save(lobes_diagram(robot.name, lobes), folder / "lobes", formats)
    return files
