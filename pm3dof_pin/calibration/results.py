"""A calibration as a folder: summary, measurements, calibrated robot, compensation. Read again without any of it run.

    calibration.yaml     what was done and found, with units in the names
    compensation.json    what commands are corrected by
    measurements.csv     what it was made from
    nominal/             the robot as described: URDF, closures, error parameters
    calibrated/          the same with the parameters identified, for any other program (methods with "lm")
    report.html          written by :mod:`pm3dof_pin.figures.calibration_report`

The same measurements, method and seed give the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pm3dof_pin.calibration.calibrate import Calibration, HeldOut
from pm3dof_pin.calibration.calibrated_urdf import write_calibrated_robot
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.gaussian_process import GaussianProcess
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.measurements import Measurements, command_units, write_measurements
from pm3dof_pin.calibration.neural_network import NeuralNetwork
from pm3dof_pin.calibration.pseudo_error import InputScale, PseudoErrorModel
from pm3dof_pin.calibration.registration import Registration
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import quaternion
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import replace_directory, write_text_atomically
from pm3dof_pin.typing import Array

SUMMARY = "calibration.yaml"
COMPENSATION = "compensation.json"
MEASUREMENTS = "measurements.csv"
REPORT = "report.html"

_FORMAT = 1
_READERS: dict[str, Callable[[Mapping[str, Any]], PseudoErrorModel]] = {
    "gaussian process": GaussianProcess.from_data,
    "neural network": NeuralNetwork.from_data,
}


def write_calibration(
    calibration: Calibration,
    robot: str | Path,
    directory: Path | str,
    held_out: HeldOut | None = None,
    report: str | None = None,
) -> Path:
    """Write a calibration, whole or not at all; an older one in its place is replaced.

    Args:
        calibration: what to write.
        robot: name or path of the robot as described.
        directory: folder to write.
        held_out: how good it is on measurements it has not seen.
        report: HTML page to go with it.

    Returns:
        The folder.

    Raises:
        OutputError: the folder cannot be written, or something that is no calibration is there.
        UnknownRobotError: no such robot.
    """
    compensation, files = calibration.compensation, find_robot(robot)
    with replace_directory(directory, SUMMARY) as folder:
        for source in (files.path, files.closures, files.errors, files.srdf):
            if source is not None and source.is_file():
                write_text_atomically(folder / "nominal" / source.name, source.read_text(encoding="utf-8"))
        if compensation.values is not None:
            write_calibrated_robot(compensation.errors, compensation.values, robot, folder / "calibrated")
        write_measurements(calibration.measurements, compensation.errors, folder / MEASUREMENTS)
        write_text_atomically(folder / COMPENSATION, compensation_as_json(compensation, files.path.name))
        summary = yaml.safe_dump(summary_of(calibration, files.path.stem, held_out), sort_keys=False, width=120)
        write_text_atomically(folder / SUMMARY, summary)
        if report is not None:
            write_text_atomically(folder / REPORT, report)
    return Path(directory)


def read_compensation(directory: Path | str) -> Compensation:
    """Read what :func:`write_calibration` wrote, ready to correct commands.

    Args:
        directory: the folder.

    Raises:
        DescriptionError: it is no calibration, or damaged.
    """
    path = Path(directory) / COMPENSATION
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DescriptionError(path, "JSON", f"expected the compensation of a calibration ({error})") from error
    try:
        return _compensation(data, Path(directory))
    except (KeyError, TypeError, ValueError) as error:
        raise DescriptionError(path, "contents", f"expected those of format {_FORMAT} ({error!r})") from error


def summary_of(calibration: Calibration, robot: str, held_out: HeldOut | None = None) -> dict[str, Any]:
    """Return what was done and found as plain data; keys end in their unit.

    Args:
        calibration: the calibration.
        robot: name of the robot.
        held_out: how good it is on measurements it has not seen.
    """
    how, found = calibration.options, calibration.identification
    summary: dict[str, Any] = {
        "format": _FORMAT,
        "robot": robot,
        "method": how.method,
        "seed": how.seed,
        "eta_m_per_rad": how.eta,
        "measurements": _measurements_summary(calibration.measurements),
        "outlier_lines": list(found.outlier_lines),
        "noise_factor": found.noise_factor,
        "unexplained_tip_error_m": calibration.compensation.unexplained,
    }
    if held_out is not None:
        summary["held_out"] = held_out_summary(held_out, command_units(calibration.compensation.errors.mechanism))
    if calibration.compensation.values is not None:
        summary["identification"] = _identification_summary(found)
    return summary


def held_out_summary(held_out: HeldOut, units: Iterable[str]) -> dict[str, Any]:
    """Return mean, 95th percentile and greatest error over the held-out poses [m].

    Args:
        held_out: the errors.
        units: of the actuated joints, in which the excess joint error is; they end its key.
    """
    kinds = {
        "tip_error_before_m": held_out.before,
        "tip_error_after_m": held_out.after,
        "tip_error_floor_m": held_out.floor,
        "tip_noise_m": held_out.noise,
        "_".join(["excess_joint_error", *sorted(set(units))]): held_out.excess,
    }
    return {"poses": len(held_out.rows)} | {name: statistics(values) for name, values in kinds.items()}


def statistics(values: Array) -> dict[str, float]:
    """Return mean, 95th percentile and maximum."""
    return {
        "mean": float(np.mean(values)),
        "percentile_95": float(np.percentile(values, 95.0)),
        "max": float(np.max(values)),
    }


def compensation_as_json(compensation: Compensation, urdf: str) -> str:
    """Return a compensation as JSON, every digit kept.

    Args:
        compensation: what to write.
        urdf: name of the nominal robot's URDF.
    """
    covariance, scale = compensation.covariance, compensation.inputs
    if covariance is not None:
        # what nothing tells moves the tool by nothing that was ever seen; JSON has no infinity
        covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    data = {
        "format": _FORMAT,
        "urdf": urdf,
        "eta_m_per_rad": compensation.eta,
        "unexplained_m": compensation.unexplained,
        "parameters": list(compensation.errors.names),
        "values": None if compensation.values is None else compensation.values.tolist(),
        "covariance": None if covariance is None else covariance.tolist(),
        "inputs": None
        if scale is None
        else {
            "conditions": list(scale.conditions),
            "centre": scale.centre.tolist(),
            "half_range": scale.half_range.tolist(),
        },
        "pseudo_error": None if compensation.learned is None else compensation.learned.as_data(),
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _compensation(data: Mapping[str, Any], directory: Path) -> Compensation:
    errors = GeometricErrors.load(directory / "nominal" / data["urdf"]).select(data["parameters"])
    scale, learned = data["inputs"], data["pseudo_error"]
    model: PseudoErrorModel | None = None if learned is None else _READERS[learned["kind"]](learned)
    return Compensation(
        errors,
        None if data["values"] is None else errors.values(data["values"]),
        None if data["covariance"] is None else np.array(data["covariance"], dtype=float),
        model,
        None
        if scale is None
        else InputScale(tuple(scale["conditions"]), np.array(scale["centre"]), np.array(scale["half_range"])),
        float(data["eta_m_per_rad"]),
        float(data["unexplained_m"]),
    )


def _measurements_summary(measurements: Measurements) -> dict[str, Any]:
    return {
        "count": len(measurements),
        "measured": measurements.measured,
        "conditions": list(measurements.conditions),
        "median_sigma_m_rad": [float(sigma) for sigma in np.median(measurements.sigmas, axis=0)],
        "warnings": list(measurements.warnings),
    } | _registration_summary(measurements.registration)


def _registration_summary(registration: Registration | None) -> dict[str, Any]:
    if registration is None:
        return {}
    base = registration.base
    return {
        "base_in_instrument_frame": {
            "position_m": base[:3, 3].tolist(),
            "quaternion_wxyz": quaternion(base[:3, :3]).tolist(),
            "residual_m": registration.residual,
        }
    }


def _identification_summary(found: Identification) -> dict[str, Any]:
    errors, k = found.errors, found.prior
    parameters = {
        name: {
            "value": float(value),
            "sigma": float(sigma),
            "tolerance": float(tolerance),
            "unit": unit,
        }
        for name, value, sigma, tolerance, unit in zip(
            errors.names, found.values, found.sigmas, errors.tolerances, errors.units, strict=True
        )
    }
    return {
        "prior_tolerances": k,
        "steps": found.steps,
        "identifiable_combinations": found.identifiability.rank,
        "says_nothing_about": list(found.identifiability.unidentifiable),
        "says_little_about": list(found.untold),
        "parameters": parameters,
    }
