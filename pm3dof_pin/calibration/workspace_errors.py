"""Estimated accuracy of a calibration over the workspace."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.errors.command_correction import nearest_poses
from pm3dof_pin.errors.error_map import section_grid
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.registration import register
from pm3dof_pin.typing import Array, Mask

_logger = logging.getLogger(__name__)

_POINTS = 41  # along each coordinate


@dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """Tip errors over two coordinates, with the others in the middle of their ranges; NaN beyond the limits.

    Attributes:
        names: the two coordinates.
        units: their units, "rad" or "m".
        coordinates: their values, shape=(points,) each [m, rad].
        before: tip error with the commands of the description, after a registration of its own if the instrument has
            its own frame, shape=(points, points) [m].
        after: tip error expected with corrected commands [m].
        floor: part of `before` that no command corrects, according to the calibrated model [m]; None for a method
            without parameters.
        within: function of points of the section, shape=(n, 2): whether they are within the limits.
    """

    names: tuple[str, str]
    units: tuple[str, str]
    coordinates: tuple[Array, Array]
    before: Array
    after: Array
    floor: Array | None
    within: Callable[[Array], Mask] | None = None

    @classmethod
    def from_fit(cls, calibration: Fit) -> WorkspaceErrors | None:
        """Compute errors over the first two coordinates with ranges, at mean measured conditions.

        None without two such coordinates, and where no pose of the section is within reach of the calibrated machine.
        """
        compensation = calibration.compensation
        robot = compensation.errors.robot
        grid = section_grid(robot, points=_POINTS)
        if grid is None or len(grid.dims) < 2:
            return None
        poses = robot.solve(grid, on_failure="nan")
        within = poses.within_limits
        conditions = {name: float(values.mean()) for name, values in calibration.measurements.conditions.items()}
        used = () if compensation.learned is None else compensation.learned.inputs.conditions
        known = {name: conditions[name] for name in used}
        expected = compensation.compensate(poses[within], known, on_failure="nan").predicted_error
        # near singular poses the machine may not reach as far as its description
        taken = np.isfinite(expected) & compensation.model_poses(poses[within], "nan").solved
        if not taken.any():
            names, count = " and ".join(grid.dims), int(within.sum())
            _logger.warning("no map over %s: errors are known at none of %d poses within the limits", names, count)
            return None
        inside = tuple(indices[taken] for indices in np.nonzero(within))
        nominal, expected = poses[inside], expected[taken]
        seen = compensation.poses(nominal, conditions).transforms

        def spread(values: Array) -> Array:
            field = np.full(grid.shape, np.nan)
            field[inside] = values
            return field

        floor = None
        if compensation.values is not None:
            nearest = nearest_poses(nominal, seen, compensation.eta, on_failure="nan").transforms
            floor = spread(tip_error(pose_difference(nearest, seen), compensation.eta, robot.tool_motions))
        if calibration.measurements.registration is not None:  # the robot as described has another base
            found = register(seen[:, :3, 3], nominal.positions, seen[:, :3, :3], nominal.rotations)
            seen = seen.copy()
            seen[:, :3, 3], seen[:, :3, :3] = found.positions(seen[:, :3, 3]), found.rotations(seen[:, :3, :3])
        first, second = grid.dims
        return cls(
            (first, second),
            (robot.coordinate(first).unit, robot.coordinate(second).unit),
            (grid.axes[first], grid.axes[second]),
            spread(tip_error(pose_difference(nominal.transforms, seen), compensation.eta, robot.tool_motions)),
            spread(expected),
            floor,
            _within(robot, grid),
        )


def _within(robot: Robot, grid: Grid) -> Callable[[Array], Mask]:
    """Return the limits as a function of the grid's coordinates, with the others as fixed in it."""
    fixed = np.array([grid.fixed.get(coordinate.name, 0.0) for coordinate in robot.coordinates])
    columns = [[coordinate.name for coordinate in robot.coordinates].index(name) for name in grid.dims]

    def within(points: Array) -> Mask:
        values = np.tile(fixed, (len(points), 1))
        values[:, columns] = points
        return robot.solve(values, on_failure="nan").within_limits

    return within
