"""Quantities of a robot over a grid of its coordinates, as a labelled dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Poses, Robot
from pm3dof_pin.maps.labels import (
    BROKEN_LIMITS,
    coordinate_attributes,
    dataset_attributes,
    flag_attributes,
    flag_type,
    limit_names,
)
from pm3dof_pin.maps.limit_space import coordinates_over
from pm3dof_pin.maps.quantities import select_quantities
from pm3dof_pin.maps.quantity import Evaluation, MappedRobot
from pm3dof_pin.typing import Array, Mask

if TYPE_CHECKING:
    import xarray as xr

Variable: TypeAlias = tuple[tuple[str, ...], Array, dict[str, Any]]
"""Own dimensions, values at the poses within the limits, shape=(n, *own dimensions), and attributes."""


def quantity_map(
    mapped: MappedRobot,
    grid: Grid,
    quantities: Iterable[str],
) -> xr.Dataset:
    """Compute quantities over a grid, see :func:`grid_dataset`; NaN where a pose breaks a limit or is out of reach.

    Raises:
        InvalidValueError: an unknown quantity, or one that the robot does not have.
    """
    selected = select_quantities(quantities, mapped)
    poses = mapped.robot.solve(grid, on_failure="nan")
    evaluation = Evaluation(mapped, poses[poses.within_limits])
    variables: dict[str, Variable] = {}
    labels: dict[str, list[str]] = {}
    for entry in selected:
        attributes = {"units": entry.unit_for(mapped), "long_name": entry.long_name}
        variables[entry.name] = (tuple(dim.name for dim in entry.dims), entry.compute(evaluation), attributes)
        labels |= {dim.name: list(dim.labels(mapped)) for dim in entry.dims}
    title = f"Elastic behaviour of {mapped.robot.name} over {', '.join(grid.dims)}"
    dataset = grid_dataset(grid, poses, variables, title)
    return dataset.assign_coords(labels).assign_attrs(model="elastic")


def quantities_over(mapped: MappedRobot, grid: Grid, quantities: Iterable[str]) -> Callable[[Array], dict[str, Array]]:
    """Return quantities as a function of points in a grid's coordinates, shape=(n, m); NaN beyond the limits."""
    selected = select_quantities(quantities, mapped)
    complete = coordinates_over(mapped.robot, grid.dims, grid.fixed)

    @lru_cache(maxsize=1)  # the pictures of one map share their points
    def at(data: bytes) -> dict[str, Array]:
        points = np.frombuffer(data).reshape(-1, len(grid.dims))
        poses = mapped.robot.solve(complete(points), on_failure="nan")
        evaluation = Evaluation(mapped, poses[poses.within_limits])
        return {entry.name: spread(entry.compute(evaluation), poses.within_limits) for entry in selected}

    return lambda points: at(np.ascontiguousarray(points, dtype=float).tobytes())


def spread(values: Array, within: Mask) -> Array:
    """Scatter values of the poses within the limits to their places, NaN elsewhere."""
    field = np.full((*within.shape, *values.shape[1:]), np.nan)
    field[within] = values
    return field


def poses_within_limits(robot: Robot, grid: Grid) -> tuple[Poses, Poses]:
    """Solve a grid; return its poses, unsolved ones NaN, and those within the limits, shape=(n,).

    Raises:
        UnreachablePoseError: no pose of the grid is within the limits.
    """
    poses = robot.solve(grid, on_failure="nan")
    if not poses.within_limits.any():
        fixed = ", ".join(f"{name} = {value:g}" for name, value in grid.fixed.items())
        place = f"over {', '.join(grid.dims)}{' at ' if fixed else ''}{fixed}"
        raise UnreachablePoseError(f"no pose of the grid {place} is within the limits")
    return poses, poses[poses.within_limits]


def grid_dataset(grid: Grid, poses: Poses, variables: Mapping[str, Variable], title: str) -> xr.Dataset:
    """Return variables over a grid as a dataset, NaN beyond the limits, with `broken_limits` of its poses.

    Coordinates have their units; fixed ones are scalars.
    """
    import xarray as xr

    robot, names = poses.robot, limit_names(poses.robot)
    fields = {}
    for name, (own_dims, values, variable_attributes) in variables.items():
        fields[name] = ((*grid.dims, *own_dims), spread(values, poses.within_limits), variable_attributes)
    attributes = flag_attributes(names, "limits that the pose breaks")
    flags = (grid.dims, poses.broken_limits.astype(flag_type(names)), attributes)
    coordinates = {
        c.name: (
            (c.name,) if c.name in grid.axes else (),
            grid.axes.get(c.name, grid.fixed.get(c.name)),
            coordinate_attributes(c.name, c.unit, robot.name),
        )
        for c in grid.coordinates
    }
    return xr.Dataset({**fields, BROKEN_LIMITS: flags}, coords=coordinates, attrs=dataset_attributes(title, robot.name))
