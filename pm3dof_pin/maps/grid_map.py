"""Quantities of a robot over a grid of its coordinates, as a labelled dataset."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

import pm3dof_pin
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.maps.limit_flags import BROKEN_LIMITS, flag_attributes, flag_type, limit_names
from pm3dof_pin.maps.quantities import Evaluation, MappedRobot, select_quantities
from pm3dof_pin.typing import Array, Engine

if TYPE_CHECKING:
    import xarray as xr


def quantity_map(
    mapped: MappedRobot,
    grid: Grid,
    quantities: Iterable[str],
    *,
    engine: Engine = "program",
    threads: int | None = None,
) -> xr.Dataset:
    """Compute quantities over a grid, see :func:`grid_dataset`; NaN where a pose breaks a limit or is out of reach.

    Raises:
        InvalidValueError: an unknown quantity, or one that the robot does not have.
    """
    selected = select_quantities(quantities, mapped)
    poses = mapped.robot.solve(grid, on_failure="nan", engine=engine)
    evaluation = Evaluation(mapped, poses[poses.within_limits], engine=engine, threads=threads)
    variables: dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]] = {}
    labels: dict[str, list[str]] = {}
    for entry in selected:
        values = np.full((*poses.shape, *entry.shape_for(mapped)), np.nan)
        values[poses.within_limits] = entry.compute(evaluation)
        attributes = {"units": entry.unit_for(mapped), "long_name": entry.long_name}
        variables[entry.name] = ((*grid.dims, *(dim.name for dim in entry.dims)), values, attributes)
        labels |= {dim.name: list(dim.labels(mapped)) for dim in entry.dims}
    dataset = grid_dataset(
        grid, poses, variables, f"Elastic behaviour of {mapped.robot.name} over {', '.join(grid.dims)}"
    )
    return dataset.assign_coords(labels).assign_attrs(model="elastic")


def grid_dataset(
    grid: Grid, poses: Poses, variables: Mapping[str, tuple[tuple[str, ...], Array, dict[str, Any]]], title: str
) -> xr.Dataset:
    """Return variables (dimensions, values, attributes) over a grid as a dataset, with `broken_limits` of its poses.

    Coordinates have their units; those that stand still are scalars.
    """
    import xarray as xr

    robot, names = poses.robot, limit_names(poses.robot)
    attributes = flag_attributes(names, "limits that the pose breaks")
    flags = (grid.dims, poses.broken_limits.astype(flag_type(names)), attributes)
    coordinates = {
        c.name: (
            (c.name,) if c.name in grid.axes else (),
            grid.axes.get(c.name, grid.fixed.get(c.name)),
            {"units": c.unit, "long_name": f"coordinate {c.name} of {robot.name}"},
        )
        for c in grid.coordinates
    }
    return xr.Dataset(
        {**variables, BROKEN_LIMITS: flags},
        coords=coordinates,
        attrs={
            "Conventions": "CF-1.8",
            "title": title,
            "machine": robot.name,
            "source": f"pm3dof-pin {pm3dof_pin.__version__}",
        },
    )
