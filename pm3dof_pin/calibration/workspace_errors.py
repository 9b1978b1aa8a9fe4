"""Errors over a section of the workspace, before and after a calibration, as far as the calibration knows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.calibration.calibrate import Calibration
from pm3dof_pin.calibration.pseudo_error import nearest_commands
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.reachable_poses import coordinate_ranges
from pm3dof_pin.typing import Array


@dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """Tip errors over two motion coordinates, the others in the middle of their ranges; NaN beyond joint limits.

    Attributes:
        names: the two motion coordinates.
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


def workspace_errors(calibration: Calibration, points: int = 41) -> WorkspaceErrors:
    """Compute errors over the first two motion coordinates, under the mean conditions of the measurements.

    Args:
        calibration: the calibrated machine.
        points: number of values of each coordinate.

    Raises:
        DescriptionError: the mechanism has fewer than two motion coordinates.
    """
    compensation = calibration.compensation
    mechanism = compensation.errors.mechanism
    if len(mechanism.coordinates) < 2:
        raise DescriptionError(mechanism.name, "coordinates", "expected at least two for a map")
    lower, upper = coordinate_ranges(mechanism, mechanism.coordinates)
    axes = [np.linspace(lower[k], upper[k], points) for k in range(2)]
    grid = np.tile(0.5 * (lower + upper), (points * points, 1))
    grid[:, :2] = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    poses = mechanism.solve(grid, on_failure="nan")
    poses = poses[poses.within_limits]
    conditions: dict[str, Array | float] = {
        name: float(values.mean()) for name, values in calibration.measurements.conditions.items()
    }
    seen = compensation.poses(poses, conditions).transforms
    columns = {
        "before": tip_error(pose_difference(poses.transforms, seen), compensation.eta),
        "after": compensation.predicted_error(poses, conditions),
    }
    if compensation.values is not None:
        nearest = nearest_commands(poses, seen, compensation.eta).transforms
        columns["floor"] = tip_error(pose_difference(nearest, seen), compensation.eta)
    places = [np.rint((poses.coordinates[:, k] - axes[k][0]) / np.ptp(axes[k]) * (points - 1)) for k in (0, 1)]
    fields: dict[str, Array] = {}
    for name, values in columns.items():
        field = np.full((points, points), np.nan)
        field[places[0].astype(int), places[1].astype(int)] = values
        fields[name] = field
    first, second = mechanism.coordinates[:2]
    return WorkspaceErrors(
        (first.name, second.name),
        (first.unit, second.unit),
        (axes[0], axes[1]),
        fields["before"],
        fields["after"],
        fields.get("floor"),
    )
