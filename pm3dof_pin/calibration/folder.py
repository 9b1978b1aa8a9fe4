"""A calibration as a folder: summary, measurements, calibrated robot, compensation. Reading it runs no code.

    calibration.yaml     method and results, with units in the names
    compensation.json    data for correcting commands
    measurements.csv     the measurements used
    nominal/             the robot as described: URDF, closures, error parameters
    calibrated/          the same with the identified parameters, for other programs (methods with "lm")
    report.html          made by :mod:`pm3dof_pin.calibration.report`

The same measurements, method and seed give the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pm3dof_pin.calibration.calibrated_urdf import write_calibrated_robot
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.expectation import Expectation
from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.held_out import HeldOut, statistics
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.learned_part import InputScale, LearnedPart
from pm3dof_pin.calibration.scatter import Scatter
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import quaternion
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import read_bytes, replace_directory, write_text_atomically
from pm3dof_pin.measuring.measurement_file import write_measurements
from pm3dof_pin.typing import Array

_SUMMARY = "calibration.yaml"
_COMPENSATION = "compensation.json"
MEASUREMENTS = "measurements.csv"
REPORT = "report.html"

_ISO_9283 = ("pose", "visits", "accuracy_AP_m", "repeatability_RP_m")
_GREATEST = 1e12
_GREATEST_ERROR = 1.0  # of a geometric parameter [m, rad]
_GREATEST_LENGTH = 1e4  # that weighs a rotation [m/rad]
_ROUNDING = 1e-6
_MOST_DEPTH = 12
_FORMAT = 1


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
    sources = [(source, source.name) for source in (files.path, files.closures, files.srdf) if source is not None]
    with replace_directory(directory, _SUMMARY) as folder:
        for source, name in [*sources, (errors_file, files.errors.name)]:
            if source.is_file():
                write_text_atomically(folder / "nominal" / name, source.read_text(encoding="utf-8"))
        if compensation.values is not None:
            factors = {name: factor for name, (factor, _) in compensation.stiffness.items()}
            write_calibrated_robot(compensation.errors, compensation.values, folder / "calibrated", factors)
        write_measurements(calibration.measurements, compensation.errors.robot, folder / MEASUREMENTS)
        write_text_atomically(folder / _COMPENSATION, _compensation_as_json(compensation, files.path.name))
        text = yaml.safe_dump(dict(summary), sort_keys=False, width=120, allow_unicode=True)
        write_text_atomically(folder / _SUMMARY, text)
        write_text_atomically(folder / REPORT, report)
    return Path(directory)


def read_compensation(directory: Path | str) -> Compensation:
    """Read what :func:`write_calibration` wrote, ready to correct commands.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(1)
        >>> machine = pm.SimulatedMachine.random(errors, generator, everything=False)
        >>> commands = pm.reachable_poses(errors.robot, 40, generator).commands
        >>> measurements = pm.Measurements.of_poses(commands, machine.measure(commands, generator))
        >>> folder = pm.calibrate(measurements, errors, "lm").save("calibration")
        >>> pm.read_compensation(folder).compensate(errors.robot.solve([[0.1, -0.2, 0.5]])).commands.shape
        (1, 3)

    Args:
        directory: the folder.

    Raises:
        DescriptionError: it is not a calibration, or it is damaged.
    """
    path = Path(directory) / _COMPENSATION
    try:
        data = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise DescriptionError(path, "JSON", f"expected the compensation of a calibration ({error})") from error
    _require_plausible(path, data)
    try:
        return _compensation(data, Path(directory))
    except (AttributeError, KeyError, IndexError, TypeError, ValueError) as error:
        raise DescriptionError(path, "contents", f"expected those of format {_FORMAT} ({error!r})") from error


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
    kinds = {
        "tip_error_before_m": errors.before,
        "tip_error_after_m": errors.after,
        "tip_error_floor_m": errors.floor,
        "tip_noise_m": errors.noise,
        excess: errors.excess,
        **dict(zip(("energy_before_m", "energy_after_m", "energy_floor_m"), errors.energies, strict=True)),
    }
    named: dict[str, Any] = {name: statistics(values) for name, values in kinds.items() if np.isfinite(values).all()}
    if errors.excess_interval is not None and excess in named:
        named[excess]["rms_95_percent_interval"] = list(errors.excess_interval)
    return {"poses": len(errors.after)} | named | {"within_95_percent_bound": errors.within}


def _compensation_as_json(compensation: Compensation, urdf: str) -> str:
    """Return a compensation as JSON at full precision, naming the nominal robot's URDF."""
    # JSON has no infinity
    covariance, learned = compensation.known_covariance, compensation.learned
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
        "tool_frame": compensation.errors.robot.tool_frame,
        "eta_m_per_rad": compensation.eta,
        "unexplained_m": compensation.scatter.tip_error,
        "scatter_everywhere_m2": compensation.scatter.everywhere.tolist(),
        "scatter_of_drives": compensation.scatter.drives.tolist(),
        "parameters": list(compensation.errors.names),
        "values": None if compensation.values is None else compensation.values.tolist(),
        "covariance": None if covariance is None else covariance.tolist(),
        "stiffness": {name: list(pair) for name, pair in compensation.stiffness.items()},
        "inputs": scale,
        "pseudo_error": None if learned is None else learned.model.as_data(),
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _compensation(data: Mapping[str, Any], directory: Path) -> Compensation:
    path = directory / _COMPENSATION
    if Path(data["urdf"]).name != data["urdf"]:
        raise DescriptionError(path, "urdf", f"expected the name of a file, not '{data['urdf']}'")
    described = GeometricErrors.load(directory / "nominal" / data["urdf"], tool_frame=data.get("tool_frame"))
    errors = described.select(data["parameters"])
    values = None if data["values"] is None else errors.values(data["values"])
    if values is not None and np.abs(values).max(initial=0.0) > _GREATEST_ERROR:
        worst = int(np.abs(values).argmax())
        expected = f"expected errors of at most {_GREATEST_ERROR:g} m or rad, not {values[worst]:g}"
        raise DescriptionError(path, f"values of {errors.names[worst]}", expected)
    # with twelve rows more if the measurements define base and tool
    sizes = (len(errors), len(errors) + 12)
    covariance = None if data["covariance"] is None else _semidefinite(path, "covariance", data, sizes)
    if not 0.0 < float(data["eta_m_per_rad"]) <= _GREATEST_LENGTH:
        expected = f"expected a length up to {_GREATEST_LENGTH:g}, not {data['eta_m_per_rad']}"
        raise DescriptionError(path, "eta_m_per_rad", expected)
    scale, learned = data["inputs"], None
    if scale is not None:
        inputs = InputScale(tuple(scale["conditions"]), np.array(scale["centre"]), np.array(scale["half_range"]))
        learned = LearnedPart.from_data(data["pseudo_error"], inputs)
        _require_answer(path, learned, errors)
    return Compensation(
        errors,
        values,
        covariance,
        learned,
        float(data["eta_m_per_rad"]),
        _scatter(path, data, len(errors.robot.commands)),
        {name: (float(factor), float(sigma)) for name, (factor, sigma) in data.get("stiffness", {}).items()},
    )


def _require_answer(path: Path, learned: LearnedPart, errors: GeometricErrors) -> None:
    """Evaluate the learned part once, at home: damage shows in its factorisation or in its answer."""
    try:
        home, middle = errors.robot.home.commands[None], learned.inputs.middle()
        answers = np.array([learned.deviations(home, middle), learned.uncertainties(home, middle)])
    except (ArithmeticError, IndexError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise DescriptionError(path, "pseudo_error", f"expected a model that can be evaluated ({error})") from error
    if not np.abs(answers).max(initial=0.0) <= _GREATEST_ERROR:  # also for NaN
        expected = f"expected corrections of at most {_GREATEST_ERROR:g} m or rad, not {answers.tolist()}"
        raise DescriptionError(path, "pseudo_error", expected)


def _require_plausible(path: Path, data: Any, place: str = "") -> None:
    """Reject missing numbers, numbers beyond any plausible value, and deeply nested lists."""
    if isinstance(data, (dict, list)):
        if place.count(".") > _MOST_DEPTH:
            raise DescriptionError(path, place, "expected fewer nested lists")
        if isinstance(data, list) and None in data:
            raise DescriptionError(path, f"{place}.{data.index(None)}", "expected a number, not null")
        for key, entry in data.items() if isinstance(data, dict) else enumerate(data):
            _require_plausible(path, entry, f"{place}.{key}" if place else str(key))
    elif isinstance(data, (int, float)) and not abs(data) <= _GREATEST:
        raise DescriptionError(path, place, f"expected a number of at most {_GREATEST:g}, not {data}")


def _semidefinite(path: Path, key: str, data: Mapping[str, Any], sizes: Sequence[int]) -> Array:
    matrix, size = np.array(data[key], dtype=float), len(data[key])
    if size not in sizes or matrix.shape != (size, size):
        expected = " or ".join(f"{size} x {size}" for size in sizes)
        raise DescriptionError(path, key, f"expected {expected} numbers, not an array of shape {matrix.shape}")
    scale = np.sqrt(np.maximum(matrix.diagonal(), np.finfo(float).tiny))
    scaled = matrix / np.outer(scale, scale)
    if size and (np.abs(scaled - scaled.T).max() > _ROUNDING or np.linalg.eigvalsh(scaled)[0] < -_ROUNDING * size):
        raise DescriptionError(path, key, "expected a covariance: symmetric, without negative eigenvalues")
    return matrix


def _scatter(path: Path, data: Mapping[str, Any], drives: int) -> Scatter:
    """Return the scatter; for older files, which contain less, the same in all directions."""
    size = float(data["unexplained_m"])
    everywhere = np.broadcast_to(np.array(data.get("scatter_everywhere_m2", size**2 / 6.0), dtype=float), 2)
    found = Scatter(everywhere, np.array(data.get("scatter_of_drives", []), dtype=float), size)
    if len(found.drives) not in (0, drives) or min(*everywhere, *found.drives) < 0.0:
        raise DescriptionError(path, "scatter_of_drives", f"expected {drives} non-negative variances")
    return found


def _measurements_summary(calibration: Fit) -> dict[str, Any]:
    measurements, found = calibration.measurements, calibration.identification
    summary: dict[str, Any] = {
        "count": len(measurements),
        "poses": int(measurements.pose_numbers.max()) + 1,
        "measured": measurements.measured,
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
    rows = zip(errors.names, found.values, found.sigmas, errors.tolerances, errors.units, strict=True)
    return {
        "prior_tolerances": found.prior,
        "steps": found.steps,
        "identifiable_combinations": found.identifiability.rank,
        "says_nothing_about": list(found.identifiability.unidentifiable),
        "says_little_about": list(found.prior_dominated),
        "parameters": {
            name: {"value": float(value), "sigma": float(sigma), "tolerance": float(tolerance), "unit": unit}
            for name, value, sigma, tolerance, unit in rows
        },
        "stiffness": {
            name: {"factor": factor, "sigma_of_logarithm": sigma} for name, (factor, sigma) in found.stiffness.items()
        },
    }
