"""A calibration as a folder: summary, measurements, calibrated robot, compensation. Reading it runs no code.

    calibration.yaml     method and results, with units in the names
    compensation.json    data for correcting commands
    measurements.csv     the measurements used
    nominal/             the robot as described: URDF, closures, error parameters
    calibrated/          the same with the identified parameters, for other programs (methods with "lm")
    report.html          made by :mod:`pm3dof_pin.calibration.report`
    history.jsonl        what later checks found (:mod:`pm3dof_pin.calibration.recheck`)
    SHA256SUMS           checksums of all these but the history: `sha256sum -c SHA256SUMS` verifies them

The same measurements, method and seed give the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pm3dof_pin.calibration.calibrated_urdf import write_calibrated_robot
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.expectation import Expectation
from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.learned_part import InputScale, LearnedPart
from pm3dof_pin.calibration.scatter import Scatter
from pm3dof_pin.calibration.session_effects import SessionEffects
from pm3dof_pin.description.yaml_file import read_mapping, yaml_text
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import quaternion, tip_weights
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import read_bytes, read_text, replace_directory, write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurement_file import write_measurements
from pm3dof_pin.measuring.measurements import Measurements

_SUMMARY = "calibration.yaml"
_COMPENSATION = "compensation.json"
MEASUREMENTS = "measurements.csv"
REPORT = "report.html"
HISTORY = "history.jsonl"
"""What later checks found, one JSON object a line; kept when the folder is replaced."""

ACCURACIES = {
    "tip_error_before_m": "as described",
    "tip_error_after_m": "corrected",
    "tip_error_floor_m": "best commands (floor)",
    "tip_noise_m": "measurement noise",
    "excess_joint_error_m": "each command off the best [µm]",
    "excess_joint_error_rad": "each command off the best [µrad]",
    "excess_joint_error_m_rad": "each command off the best [µm, µrad]",
    "energy_before_m": "E of (8.15), as described",
    "energy_after_m": "E of (8.15), corrected",
    "energy_floor_m": "E of (8.15), best commands (floor)",
}
"""Errors of held-out poses, by their keys in the summary, in words."""

_ISO_9283 = ("pose", "visits", "accuracy_AP_m", "repeatability_RP_m")
_SUMS = "SHA256SUMS"
_FORMAT = 2
_WITHOUT_SUMS = 1  # format of folders without checksums


def write_calibration(calibration: Fit, directory: Path | str, summary: Mapping[str, Any], report: str) -> Path:
    """Write a calibration with its summary and report, atomically, replacing an older one; return the folder.

    Raises:
        DescriptionError: its robot was not read from files.
        OutputError: the folder cannot be written, or it contains something other than a calibration.
    """
    compensation, files = calibration.compensation, calibration.compensation.errors.robot.files
    if files is None:
        raise DescriptionError(compensation.errors.robot.source, "files", "expected a robot that was read from files")
    errors_file = compensation.errors.file or files.errors
    sources = [(source, source.name) for source in (files.closures, files.srdf) if source is not None]
    with replace_directory(directory, _SUMMARY) as folder:
        write_text_atomically(folder / "nominal" / files.tree_name, files.tree_text())
        for source, name in [*sources, (errors_file, files.errors.name)]:
            if source.is_file():
                write_text_atomically(folder / "nominal" / name, source.read_text(encoding="utf-8"))
        if compensation.values is not None:
            factors = {name: factor for name, (factor, _) in compensation.stiffness.items()}
            write_calibrated_robot(compensation.errors, compensation.values, folder / "calibrated", factors)
        write_measurements(calibration.measurements, compensation.errors.robot, folder / MEASUREMENTS)
        write_text_atomically(folder / _COMPENSATION, _compensation_as_json(compensation, files.tree_name))
        text = yaml_text(dict(summary))
        write_text_atomically(folder / _SUMMARY, text)
        write_text_atomically(folder / REPORT, report)
        sums = "".join(f"{_sum(file)}  {file.relative_to(folder).as_posix()}\n" for file in _files(folder))
        write_text_atomically(folder / _SUMS, sums)
        if (history := Path(directory) / HISTORY).is_file():
            write_text_atomically(folder / HISTORY, read_text(history))
    return Path(directory)


def read_compensation(directory: Path | str) -> Compensation:
    """Read what :func:`write_calibration` wrote, ready to correct commands.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(1)
        >>> machine = pm.SimulatedMachine.random(errors, generator, everything=False)
        >>> commands = pm.reachable_poses(errors.robot, 40, generator).commands
        >>> measurements = pm.Measurements.from_poses(commands, machine.measure(commands, generator))
        >>> folder = pm.calibrate(measurements, errors, "lm").save("calibration")
        >>> pm.read_compensation(folder).compensate(errors.robot.solve([[0.1, -0.2, 0.5]])).commands.shape
        (1, 3)

    Args:
        directory: the folder.

    Raises:
        DescriptionError: it is not a calibration, or what determines the commands was changed since it was written.
    """
    path = Path(directory) / _COMPENSATION
    try:
        data = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise DescriptionError(path, "JSON", f"expected the compensation of a calibration ({error})") from error
    try:
        if data["format"] != _WITHOUT_SUMS:
            _verify(Path(directory))
        return _compensation(data, Path(directory))
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise DescriptionError(path, "contents", f"expected those of format {_FORMAT} ({error!r})") from error


def read_summary(directory: Path | str) -> dict[str, Any]:
    """Return the summary of a calibration's folder, whose checksums are compared first.

    Raises:
        DescriptionError: it is not a calibration, or any of its files but the history was changed.
    """
    checksum_of(directory)
    return read_mapping(Path(directory) / _SUMMARY)


def summary_of(
    calibration: Fit,
    held_out: HeldOut | None,
    validation: HeldOut | None,
    refusals: Sequence[str],
    expectation: Expectation,
) -> dict[str, Any]:
    """Return method and results as plain data; keys end in their unit."""
    options, found, robot = calibration.options, calibration.identification, calibration.compensation.errors.robot
    summary: dict[str, Any] = {
        "format": _FORMAT,
        "robot": robot.name if robot.files is None else robot.files.name,
        **({"forced_against": list(refusals)} if refusals else {}),
        **_expectation_summary(expectation),
        "method": options.method,
        "seed": options.seed,
        "eta_m_per_rad": options.eta,
        "measurements": _measurements_summary(calibration),
        "outlier_lines": list(found.outlier_lines),
        "noise_factor": found.noise_factor,
        "unexplained_tip_error_m": calibration.compensation.scatter.tip_error,
    }
    units = sorted({command.unit for command in robot.commands})
    for name, errors in (("validation", validation), ("held_out", held_out)):
        if errors is not None:
            summary[name] = _held_out_summary(errors, "_".join(["excess_joint_error", *units]))
    if calibration.compensation.values is not None:
        summary["identification"] = _identification_summary(found)
    return summary


def _expectation_summary(expectation: Expectation) -> dict[str, Any]:
    summary: dict[str, Any] = {
        "what_to_expect": expectation.text,
        "what_was_not_seen": expectation.not_seen,
        "what_to_do_next": expectation.next,
        "tip_error_95_percent_bound_m": expectation.bound,
        "tip_error_rms_95_percent_interval_m": None if expectation.interval is None else list(expectation.interval),
        "uncertainty_budget_m": dict(expectation.budget),
    }
    if expectation.if_noise_is_larger is not None:
        summary["tip_error_rms_if_sigmas_are_too_small_m"] = expectation.if_noise_is_larger
    for found in expectation.systematic:
        summary[found.kind] = {"tip_error_m": found.tip, "tip_sigma_m": found.tip_sigma, "more_than_chance": found.sure}
    if (repeated := expectation.repeated) is not None:
        numbers = (repeated.poses + 1, repeated.visits, repeated.accuracy, repeated.repeatability)
        columns = [column.tolist() for column in numbers]
        summary["repeatability"] = {
            "tip_sigma_m": repeated.tip_sigma,
            "degrees_of_freedom": repeated.freedom,
            "iso_9283": [dict(zip(_ISO_9283, row, strict=True)) for row in zip(*columns, strict=True)],
        }
    return summary


def _held_out_summary(errors: HeldOut, excess: str) -> dict[str, Any]:
    kinds = (errors.before, errors.after, errors.floor, errors.noise, errors.excess, *errors.energies)
    keys = [key for key in ACCURACIES if key == excess or not key.startswith("excess")]
    named: dict[str, Any] = {
        key: {"mean": np.mean(values), "percentile_95": np.percentile(values, 95.0), "max": np.max(values)}
        for key, values in zip(keys, kinds, strict=True)
        if np.isfinite(values).all()
    }
    named = {key: {name: float(value) for name, value in numbers.items()} for key, numbers in named.items()}
    if errors.excess_interval is not None and excess in named:
        named[excess]["rms_95_percent_interval"] = list(errors.excess_interval)
    return {"poses": len(errors.after)} | named | {"within_95_percent_bound": errors.within}


def error_in_words(measurements: Measurements) -> str:
    """Name the error of a pose that measurements show."""
    seen = np.asarray(measurements.seen[:, : measurements.tool_columns].any(axis=0))
    if measurements.distances is not None or measurements.datums:
        return "error along what was seen"
    if seen[3:].any() or (seen.all() and len(np.unique(measurements.target_numbers)) > 1):
        return "tip error"
    return "position error" if seen.all() else f"error along {', '.join(np.array(['x', 'y', 'z'])[seen[:3]])}"


def accuracy_rows(errors: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the rows of a table of held-out errors, an entry of the summary: mean, 95th percentile, maximum [µm]."""
    return {
        text: [f"{1e6 * errors[key][name]:.1f}" for name in ("mean", "percentile_95", "max")]
        for key, text in ACCURACIES.items()
        if key in errors
    }


def _compensation_as_json(compensation: Compensation, urdf: str) -> str:
    """Return a compensation as JSON at full precision, naming the nominal robot's URDF, and what it does not say."""
    # JSON has no infinity
    covariance, learned = compensation.known_covariance, compensation.learned
    robot = compensation.errors.robot
    described = robot.description
    scale = None
    if learned is not None:
        inputs = learned.inputs
        scale = {
            "conditions": list(inputs.conditions),
            "centre": inputs.centre.tolist(),
            "half_range": inputs.half_range.tolist(),
        }
    data = {
        "format": _FORMAT,
        "urdf": urdf,
        "tool_frame": robot.tool_frame,
        "drives": None if robot.actuated_joints == described.actuated_joints else list(robot.actuated_joints),
        "springs": None if robot.springs == described.springs else [dict(entry) for entry in robot.springs],
        "hold_base": not described.floating_bodies,
        "eta_m_per_rad": compensation.eta,
        "unexplained_m": compensation.scatter.tip_error,
        "scatter_everywhere_m2": compensation.scatter.everywhere.tolist(),
        "scatter_of_drives": compensation.scatter.drives.tolist(),
        "scatter_tails": compensation.scatter.tails,
        "parameters": list(compensation.errors.names),
        "values": None if compensation.values is None else compensation.values.tolist(),
        "covariance": None if covariance is None else covariance.tolist(),
        "stiffness": {name: list(pair) for name, pair in compensation.stiffness.items()},
        "session": {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(compensation.session).items()
        },
        "inputs": scale,
        "pseudo_error": None if learned is None else learned.model.as_data(),
    }
    # a line for each entry: with one for each number of a large covariance, it takes ten times as long
    lines = (f"{json.dumps(name)}: {json.dumps(value, allow_nan=False)}" for name, value in data.items())
    return "{" + ",\n ".join(lines) + "}\n"


def _compensation(data: Mapping[str, Any], directory: Path) -> Compensation:
    if Path(data["urdf"]).name != data["urdf"]:
        raise DescriptionError(directory / _COMPENSATION, "urdf", f"expected a file's name, not '{data['urdf']}'")
    robot = Robot.load(
        directory / "nominal" / data["urdf"],
        tool_frame=data.get("tool_frame"),
        drives=data.get("drives"),
        hold_base=data.get("hold_base"),
    )
    if data.get("springs") is not None:
        robot = robot.replace(springs=data["springs"])
    errors, scale, learned = GeometricErrors.load(robot).select(data["parameters"]), data["inputs"], None
    if scale is not None:
        inputs = InputScale(tuple(scale["conditions"]), np.array(scale["centre"]), np.array(scale["half_range"]))
        learned = LearnedPart.from_data(data["pseudo_error"], inputs)
    size = float(data["unexplained_m"])
    everywhere = np.broadcast_to(np.array(data.get("scatter_everywhere_m2", size**2 / 6.0), dtype=float), 2)
    drives = np.array(data.get("scatter_of_drives", []), dtype=float)
    eta = float(data["eta_m_per_rad"])
    counted = np.sign(tip_weights(eta, errors.robot.tool_motions))
    return Compensation(
        errors,
        None if data["values"] is None else errors.values(data["values"]),
        None if data["covariance"] is None else np.array(data["covariance"], dtype=float),
        learned,
        eta,
        Scatter(everywhere, drives, size, counted=counted, tails=float(data.get("scatter_tails", 1.0))),
        {name: (float(factor), float(sigma)) for name, (factor, sigma) in data.get("stiffness", {}).items()},
        _session(data.get("session", {})),
    )


def _session(data: Mapping[str, Any]) -> SessionEffects:
    if not data:
        return SessionEffects()
    hysteresis, drift = (np.array(data[name], dtype=float) for name in ("hysteresis", "drift"))
    covariances = [
        np.array(data[f"{name}_covariance"], dtype=float).reshape(2 * values.shape)
        for name, values in (("hysteresis", hysteresis), ("drift", drift))
    ]
    return SessionEffects(
        hysteresis, covariances[0], drift, covariances[1], float(data["start"]), float(data["duration"])
    )


def _verify(directory: Path, *, everything: bool = False) -> None:
    """Compare what determines the commands, compensation and nominal robot, or everything, with the checksums."""
    lines = read_text(directory / _SUMS).splitlines()
    sums = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    found = {file.relative_to(directory).as_posix() for file in _files(directory)}
    again = f"put it back, or calibrate again from {MEASUREMENTS} as it was measured"
    for name in sorted(found | set(sums)):
        if name not in (_SUMS, HISTORY) and (everything or name == _COMPENSATION or name.startswith("nominal/")):
            if name not in found or name not in sums:
                problem = "is missing" if name in sums else "was added since the calibration was written"
                raise DescriptionError(directory / name, "file", f"{problem}: {again}")
            if _sum(directory / name) != sums[name]:
                problem = "was changed since the calibration was written"
                raise DescriptionError(directory / name, "SHA-256", f"{problem}: {again}")


def checksum_of(directory: Path | str) -> str:
    """Return the SHA-256 of a calibration's list of checksums, which stands for the whole folder.

    Raises:
        DescriptionError: the folder has no such list, or any of its files but the history was changed.
    """
    _verify(Path(directory), everything=True)
    return _sum(Path(directory) / _SUMS)


def _files(directory: Path) -> list[Path]:
    return sorted(file for file in directory.rglob("*") if file.is_file())


def _sum(file: Path) -> str:
    return hashlib.sha256(read_bytes(file)).hexdigest()


def _measurements_summary(calibration: Fit) -> dict[str, Any]:
    measurements, found = calibration.measurements, calibration.identification
    summary: dict[str, Any] = {
        "count": len(measurements),
        "poses": int(measurements.pose_numbers.max()) + 1,
        "measured": measurements.measured,
        "error_seen": error_in_words(measurements),
        "conditions": list(measurements.conditions),
        "median_sigma_m_rad": [
            float(np.median(column[np.isfinite(column)])) if np.isfinite(column).any() else None
            for column in measurements.sigmas.T
        ],
        "warnings": list(measurements.warnings),
    }
    if measurements.registration is not None:
        base, turn = measurements.registration.base, measurements.registration.rotation.T
        # along the instrument's own axes
        parts = (found.nuisance_covariance("frame")[part, part] for part in (slice(0, 3), slice(3, 6)))
        position, angle = (np.sqrt(np.diag(turn @ part @ turn.T)).tolist() for part in parts)
        summary["base_in_instrument_frame"] = {
            "position_m": base[:3, 3].tolist(),
            "quaternion_wxyz": quaternion(base[:3, :3]).tolist(),
            "position_sigma_m": position,
            "angle_sigma_rad": angle,
            "residual_m": measurements.registration.residual,
        }
    nuisances = found.nuisances
    values, sigmas = found.nuisance_values.tolist(), found.nuisance_sigmas.tolist()
    named = {
        name: {"value": value, "sigma": sigma, "unit": unit}
        for name, value, sigma, unit in zip(nuisances.names, values, sigmas, nuisances.units, strict=True)
        if not name.startswith("frame.")
    }
    return summary | ({"besides_the_machine": named} if named else {})


def _identification_summary(found: Identification) -> dict[str, Any]:
    errors = found.errors
    data = np.where(np.isfinite(found.data_sigmas), found.data_sigmas, found.sigmas)
    rows = zip(errors.names, found.values, data, found.sigmas, errors.tolerances, errors.units, strict=True)
    return {
        "prior_tolerances": found.prior.k,
        "steps": found.steps,
        "identifiable_combinations": found.identifiability.identified,
        "says_nothing_about": list(found.identifiability.unidentified),
        "says_little_about": list(found.prior_dominated),
        "parameters": {
            name: {
                "value": float(value),
                "sigma_of_the_data": float(of_data),
                "sigma": float(sigma),
                "tolerance": float(tolerance),
                "unit": unit,
            }
            for name, value, of_data, sigma, tolerance, unit in rows
        },
        "stiffness": {
            name: {
                "factor": factor,
                "sigma_of_logarithm": sigma,
                "share_of_the_data": found.stiffness_shares[name],
            }
            for name, (factor, sigma) in found.stiffness.items()
        },
    }
