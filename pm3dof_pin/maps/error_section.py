"""Errors of the tool over a grid of any robot's coordinates, as a labelled dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.errors.error_map import ErrorMap, error_map
from pm3dof_pin.errors.error_parameters import Distribution, GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.maps.grid_map import Variable, grid_dataset, poses_within_limits
from pm3dof_pin.typing import Engine

if TYPE_CHECKING:
    import xarray as xr

QUANTITIES = {
    "tip_rms": ("m", "tip error, root mean square over machines within their tolerances"),
    "compensable_rms": ("m", "tip error that commands can undo, root mean square"),
    "uncompensable_rms": ("m", "tip error that no command can undo, root mean square"),
    "worst_tip": ("m", "bound of the tip error, for all machines within their tolerances"),
    "position_rms": ("m", "position error, root mean square"),
    "orientation_rms": ("rad", "orientation error, root mean square"),
}

_DIRECTIONS = 240  # of rays that find the boundary


def error_section(
    errors: GeometricErrors,
    grid: Grid,
    *,
    eta: float = TIP_LENGTH,
    distribution: Distribution = "normal",
    engine: Engine = "program",
) -> tuple[xr.Dataset, ErrorMap]:
    """Compute the first-order errors of the tool over a grid of the robot's coordinates.

    Returns the variables of :data:`QUANTITIES` over the grid, NaN where a pose breaks a limit, and `broken_limits`; and
    the error map over the poses within the limits. `eta` weighs the orientation in the tip error [m/rad].

    Raises:
        UnreachablePoseError: no pose of the grid is within the limits.
        InvalidValueError: the loops cannot close with an error.
        SingularConfigurationError: at a pose the tool can move while all drives stand still.
    """
    robot = errors.robot
    poses, within = poses_within_limits(robot, grid, engine)
    result = error_map(errors, within, eta=eta, distribution=distribution, engine=engine)
    variables: dict[str, Variable] = {
        name: ((), getattr(result, name), {"units": unit, "long_name": long_name})
        for name, (unit, long_name) in QUANTITIES.items()
    }
    title = f"First-order errors of {robot.name} over a section of its workspace"
    dataset = grid_dataset(grid, poses, variables, title)
    return dataset.assign_attrs(
        model="error",
        eta_m_per_rad=eta,
        distribution=distribution,
        references="D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.3",
    ), result


def error_outline(errors: GeometricErrors, grid: Grid, section: xr.Dataset) -> xr.Dataset | None:
    """Compute the errors at points along the edge of a section over two coordinates, so that a picture ends smoothly.

    None if the edge is not one line that can be seen from the middle of the grid.
    """
    import xarray as xr

    from pm3dof_pin.maps.limit_space import robot_space
    from pm3dof_pin.maps.workspace_section import workspace_section

    robot, names = errors.robot, grid.dims
    edge = workspace_section(robot_space(robot, names, grid.fixed), directions=_DIRECTIONS)
    ends = np.array([[values[0], values[-1]] for values in grid.axes.values()])
    rays = edge.points - edge.space.centre
    if not edge.star_shaped or np.any(edge.space.centre <= ends[:, 0]) or np.any(edge.space.centre >= ends[:, 1]):
        return None
    to_ends = np.where(rays > 0.0, ends[:, 1], ends[:, 0]) - edge.space.centre
    shares = np.divide(to_ends, rays, out=np.full_like(rays, np.inf), where=rays != 0.0).min(axis=1)
    # a little inside, where the limits hold to rounding
    points = edge.space.centre + rays * np.minimum(1.0 - 1e-9, shares)[:, None]
    values = np.tile([grid.fixed.get(coordinate.name, 0.0) for coordinate in robot.coordinates], (_DIRECTIONS, 1))
    columns = [[c.name for c in robot.coordinates].index(name) for name in names]
    values[:, columns] = points
    poses = robot.solve(values, on_failure="nan")
    if not poses.solved.all():
        return None
    attributes = section.attrs
    result = error_map(errors, poses, eta=attributes["eta_m_per_rad"], distribution=attributes["distribution"])
    variables = {name: ("point", getattr(result, name), section[name].attrs) for name in QUANTITIES}
    variables["at_grid_end"] = ("point", shares < 1.0, {"long_name": "the grid ends here, and no limit"})
    coordinates = {name: ("point", column, section[name].attrs) for name, column in zip(names, points.T, strict=True)}
    return xr.Dataset(variables, coords=coordinates, attrs=attributes)
