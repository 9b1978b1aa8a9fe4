"""Tool errors over a grid of any robot's coordinates, as a labelled dataset."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from pm3dof_pin.errors.error_map import ErrorMap, error_map
from pm3dof_pin.errors.error_parameters import Distribution, GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.maps.grid_map import Variable, grid_dataset, poses_within_limits, spread
from pm3dof_pin.maps.limit_space import coordinates_over
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr

ERROR_VARIABLES = {
    "tip_rms": ("m", "tip error, root mean square over machines within their tolerances"),
    "compensable_rms": ("m", "tip error that commands can undo, root mean square"),
    "uncompensable_rms": ("m", "tip error that no command can undo, root mean square"),
    "worst_tip": ("m", "bound of the tip error, for all machines within their tolerances"),
    "position_rms": ("m", "position error, root mean square"),
    "orientation_rms": ("rad", "orientation error, root mean square"),
}


def error_section(
    errors: GeometricErrors,
    grid: Grid,
    *,
    eta: float = TIP_LENGTH,
    distribution: Distribution = "normal",
) -> tuple[xr.Dataset, ErrorMap]:
    """Compute the first-order errors of the tool over a grid of the robot's coordinates.

    Returns :data:`ERROR_VARIABLES` over the grid, NaN where a pose breaks a limit, with `broken_limits`; and the error
    map over the poses within the limits. `eta` weighs the orientation in the tip error [m/rad].

    Raises:
        UnreachablePoseError: no pose of the grid is within the limits.
        InvalidValueError: the loops cannot close with an error.
        SingularConfigurationError: at some pose the tool can move with all drives locked.
    """
    robot = errors.robot
    poses, within = poses_within_limits(robot, grid)
    result = error_map(errors, within, eta=eta, distribution=distribution)
    variables: dict[str, Variable] = {
        name: ((), getattr(result, name), {"units": unit, "long_name": long_name})
        for name, (unit, long_name) in ERROR_VARIABLES.items()
    }
    title = f"First-order errors of {robot.name} over a section of its workspace"
    dataset = grid_dataset(grid, poses, variables, title)
    return dataset.assign_attrs(
        model="error",
        eta_m_per_rad=eta,
        distribution=distribution,
        references="D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.3",
    ), result


def errors_over(
    errors: GeometricErrors,
    grid: Grid,
    variable: str,
    *,
    eta: float = TIP_LENGTH,
    distribution: Distribution = "normal",
) -> Callable[[Array], Array]:
    """Return one of :data:`ERROR_VARIABLES` as a function of points in a grid's coordinates, shape=(n, m) to (n,).

    For the arguments see :func:`error_section`. NaN beyond the limits.
    """
    complete = coordinates_over(errors.robot, grid.dims, grid.fixed)

    def at(points: Array) -> Array:
        poses = errors.robot.solve(complete(points), on_failure="nan")
        found = error_map(errors, poses[poses.within_limits], eta=eta, distribution=distribution)
        return spread(getattr(found, variable), poses.within_limits)

    return at
