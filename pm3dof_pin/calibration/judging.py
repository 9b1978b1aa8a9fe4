"""How good a calibration is: on measurements it was not shown, and over the workspace as far as it knows itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.calibration.calibrate import LEAST_POSES, Calibration, compensation_from
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.calibration.pseudo_error import control_inverse, pseudo_errors
from pm3dof_pin.errors.command_correction import command_scales, nearest_poses
from pm3dof_pin.errors.error_map import section_grid
from pm3dof_pin.errors.pose_error import pose_difference, tip_error, tip_weights
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Indices

_FOLDS = 5
_FLOOR_SEEN = 1e-3  # of whole poses no direction is unseen, but near a singular pose none of use can be tiny


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors at measured poses, predicted by calibrations that were not shown them. Outliers are left out.

    Attributes:
        rows: which measurements, shape=(n,).
        before: tip error of the machine as described, shape=(n,) [m].
        after: tip error with the corrected commands, the measurements' noise included, shape=(n,) [m].
        floor: tip error with the best commands, the measurements' noise included, shape=(n,) [m].
        noise: tip error that the measurements' noise amounts to, root mean square over its distribution, shape=(n,)
            [m].
        excess: by how much the corrected commands miss the best ones, root mean square over the drives' joints,
            shape=(n,) [m, rad].
    """

    rows: Indices
    before: Array
    after: Array
    floor: Array
    noise: Array
    excess: Array


def held_out_errors(calibration: Calibration) -> HeldOut:
    """Judge a calibration by cross-validation: the same method, shown four fifths of the poses at a time.

    Measurements at the same commands, of several targets or repeated, are hidden together.

    Args:
        calibration: what to judge.

    Raises:
        InvalidValueError: too few poses.
    """
    options, errors = calibration.options, calibration.compensation.errors
    rows = _trusted_rows(calibration)
    measurements = calibration.measurements[rows]
    numbers = measurements.pose_numbers
    count = int(numbers.max(initial=-1)) + 1
    if count <= LEAST_POSES:
        raise InvalidValueError("measurements", f"{count} poses", f"more than {LEAST_POSES} for a cross-validation")
    nominal = errors.robot.forward(measurements.commands)
    predicted = np.zeros_like(nominal.commands)
    folds = np.random.default_rng(options.seed).permutation(np.arange(count) % min(_FOLDS, count))[numbers]
    for fold in range(int(folds.max()) + 1):
        shown, hidden = np.flatnonzero(folds != fold), np.flatnonzero(folds == fold)
        part, found = measurements[shown], None
        if options.identifies:
            found = identify(part, errors, prior=options.prior, loss=options.loss)
        compensation = compensation_from(part, nominal[shown], errors, options, found)
        unloaded = compensation.without_loads(measurements[hidden]) if options.identifies else measurements[hidden]
        predicted[hidden] = compensation.deviations(nominal[hidden], unloaded.conditions)
    if options.identifies:
        measurements = calibration.compensation.without_loads(measurements)
    weights = tip_weights(options.eta)[: measurements.sigmas.shape[1]]
    true = pseudo_errors(measurements, nominal, options.eta)
    best = true.left
    if measurements.measured == "pose":
        best = pseudo_errors(measurements, nominal, options.eta, seen=_FLOOR_SEEN).left
    reached = errors.robot.forward(nominal.commands + predicted, guess=nominal.q)
    missed = np.einsum("nij,nj->ni", true.control, (true.deviations - predicted) / command_scales(nominal))
    excess = np.einsum("nij,nj->ni", control_inverse(true.control), missed)  # what is not seen is not judged
    return HeldOut(
        rows,
        np.linalg.norm(true.before, axis=1),
        np.linalg.norm(measurements.residuals(reached) * weights, axis=1),
        np.linalg.norm(best, axis=1),
        np.linalg.norm(measurements.sigmas * weights, axis=1),
        np.sqrt(np.mean(excess**2, axis=1)),
    )


def can_be_judged(calibration: Calibration) -> bool:
    """Tell whether there are enough poses for :func:`held_out_errors`, each part of them with enough to learn from."""
    numbers = calibration.measurements[_trusted_rows(calibration)].pose_numbers
    return int(numbers.max(initial=-1)) > LEAST_POSES


def _trusted_rows(calibration: Calibration) -> Indices:
    return np.setdiff1d(np.arange(len(calibration.measurements)), calibration.identification.outliers)


@dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """Tip errors over two coordinates, the others in the middle of their ranges; NaN beyond the limits.

    Attributes:
        names: the two coordinates.
        units: their units, "rad" or "m".
        coordinates: their values, shape=(points,) each [m, rad].
        before: tip error with the commands of the description, shape=(points, points) [m].
        after: tip error expected with corrected commands [m].
        floor: part of `before` that no command corrects, as the calibrated model has it [m]; None without parameters,
            which alone tell it.
    """

    names: tuple[str, str]
    units: tuple[str, str]
    coordinates: tuple[Array, Array]
    before: Array
    after: Array
    floor: Array | None


def workspace_errors(calibration: Calibration, points: int = 41) -> WorkspaceErrors | None:
    """Compute errors over the first two coordinates that have ranges, under the mean conditions of the measurements.

    Args:
        calibration: the calibrated machine.
        points: number of values of each coordinate.

    Returns:
        The errors; None for a robot with fewer than two coordinates that have ranges.
    """
    compensation = calibration.compensation
    robot = compensation.errors.robot
    grid = section_grid(robot, points=points)
    if grid is None or len(grid.dims) < 2:
        return None
    poses = robot.solve(grid, on_failure="nan")
    inside = np.nonzero(poses.within_limits)
    nominal = poses[inside]
    conditions = {name: float(values.mean()) for name, values in calibration.measurements.conditions.items()}
    used = () if compensation.learned is None else compensation.learned.inputs.conditions
    answer = compensation.compensate(nominal, {name: conditions[name] for name in used})
    seen = compensation.poses(nominal, conditions).transforms

    def spread(values: Array) -> Array:
        field = np.full(grid.shape, np.nan)
        field[inside] = values
        return field

    floor = None
    if compensation.values is not None:
        nearest = nearest_poses(nominal, seen, compensation.eta).transforms
        floor = spread(tip_error(pose_difference(nearest, seen), compensation.eta))
    first, second = grid.dims
    return WorkspaceErrors(
        (first, second),
        (robot.coordinate(first).unit, robot.coordinate(second).unit),
        (grid.axes[first], grid.axes[second]),
        spread(tip_error(pose_difference(nominal.transforms, seen), compensation.eta)),
        spread(answer.predicted_error),
        floor,
    )
