"""Maps over grids of a robot's coordinates, as labelled datasets: quantities, tool errors, and error budgets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pm3dof_pin.errors.error_budget import ErrorBudget, error_budget
from pm3dof_pin.errors.error_map import ErrorMap, error_map
from pm3dof_pin.errors.error_parameters import Distribution, GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.errors.tool_errors import LEAST_SENSITIVE_PART
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses, limit_names
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.datasets import (
    BROKEN_LIMITS,
    NamedArray,
    NamedArrays,
    coordinate_attributes,
    dataset_attributes,
    flag_variable,
)
from pm3dof_pin.maps.limit_space import coordinates_over
from pm3dof_pin.maps.quantities import select_quantities
from pm3dof_pin.maps.quantity import Evaluation, MappedRobot
from pm3dof_pin.typing import Array, Mask

if TYPE_CHECKING:
    import xarray as xr

_Variable: TypeAlias = tuple[tuple[str, ...], Array, dict[str, Any]]
"""Own dimensions, values at the poses within the limits, shape=(n, *own dimensions), and attributes."""

ERROR_VARIABLES = {
    "tip_rms": ("m", "tip error, root mean square over machines within their tolerances"),
    "compensable_rms": ("m", "tip error that commands can undo, root mean square"),
    "uncompensable_rms": ("m", "tip error that no command can undo, root mean square"),
    "worst_tip": ("m", "bound of the tip error, for all machines within their tolerances"),
    "position_rms": ("m", "position error, root mean square"),
    "orientation_rms": ("rad", "orientation error, root mean square"),
}

LEAST_SENSITIVE = "least_sensitive"
"""Variable that is 1 in the region least sensitive to errors, 0 elsewhere."""

_MAX_POSES = 200_000
_CHAPTER = {"model": "error", "references": "D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.3"}


def quantity_map(mapped: MappedRobot, grid: Grid, quantities: Iterable[str]) -> xr.Dataset:
    """Compute quantities over a grid, NaN where a pose breaks a limit or is out of reach.

    Raises:
        InvalidValueError: an unknown quantity, or one that the robot does not have.
    """
    return quantity_arrays(mapped, grid, quantities).dataset()


def quantity_arrays(mapped: MappedRobot, grid: Grid, quantities: Iterable[str]) -> NamedArrays:
    """Compute the map of :func:`quantity_map` without loading xarray."""
    selected = select_quantities(quantities, mapped)
    poses = mapped.robot.solve(grid, on_failure="nan")
    evaluation = Evaluation(mapped, poses[poses.within_limits])
    variables: dict[str, _Variable] = {}
    labels: dict[str, list[str]] = {}
    for entry in selected:
        attributes = {"units": entry.unit_for(mapped), "long_name": entry.long_name}
        variables[entry.name] = (tuple(dim.name for dim in entry.dims), entry.compute(evaluation), attributes)
        labels |= {dim.name: list(dim.labels(mapped)) for dim in entry.dims}
    title = f"Elastic behaviour of {mapped.robot.name} over {', '.join(grid.dims)}"
    arrays = _grid_arrays(grid, poses, variables, title)
    coordinates = {name: NamedArray((name,), np.array(own), {}) for name, own in labels.items()}
    return NamedArrays(arrays.data_vars, {**arrays.coords, **coordinates}, arrays.attrs | {"model": "elastic"})


def quantities_over(mapped: MappedRobot, grid: Grid, quantities: Iterable[str]) -> Callable[[Array], dict[str, Array]]:
    """Return quantities as a function of points in a grid's coordinates, shape=(n, m); NaN beyond the limits."""
    selected = select_quantities(quantities, mapped)

    def compute(poses: Poses) -> dict[str, Array]:
        evaluation = Evaluation(mapped, poses)
        return {entry.name: entry.compute(evaluation) for entry in selected}

    over = _over(mapped.robot, grid, compute)
    at = lru_cache(maxsize=1)(lambda data: over(np.frombuffer(data)))  # the pictures of one map share their points
    return lambda points: at(np.ascontiguousarray(points, dtype=float).tobytes())


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
    poses, within = _poses_within_limits(robot, grid)
    result = error_map(errors, within, eta=eta, distribution=distribution)
    variables: dict[str, _Variable] = {
        name: ((), getattr(result, name), {"units": unit, "long_name": long_name})
        for name, (unit, long_name) in ERROR_VARIABLES.items()
    }
    title = f"First-order errors of {robot.name} over a section of its workspace"
    dataset = _grid_arrays(grid, poses, variables, title).dataset()
    return dataset.assign_attrs(_CHAPTER, eta_m_per_rad=eta, distribution=distribution), result


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

    def compute(poses: Poses) -> dict[str, Array]:
        return {variable: getattr(error_map(errors, poses, eta=eta, distribution=distribution), variable)}

    over = _over(errors.robot, grid, compute)
    return lambda points: over(points)[variable]


def whole_workspace_grid(robot: Robot, points: int) -> Grid:
    """Make a grid of `points` values of each coordinate that has a range; the others stay at home.

    Raises:
        InvalidValueError: no coordinate has a range, or the grid would have far too many poses.
    """
    ranges = {c.name: robot.range_of(c) for c in robot.coordinates}
    limited = {name: (*ends, points) for name, ends in ranges.items() if np.isfinite(ends).all()}
    if not limited:
        raise InvalidValueError(
            "grid", problem=f"has no range for {', '.join(ranges)}", expected="coordinates with ranges; sample poses"
        )
    if points ** len(limited) > _MAX_POSES:
        most = math.floor(_MAX_POSES ** (1.0 / len(limited)) + 1e-9)
        expected = f"at most {most} over {len(limited)} coordinates; or sample poses"
        raise InvalidValueError("points", points, expected)
    return robot.grid(**limited)


def budget_map(
    sources: ErrorSources,
    grid: Grid | Poses,
    *,
    eta: float = TIP_LENGTH,
    names: Sequence[str] = (),
) -> tuple[xr.Dataset, ErrorBudget]:
    """Compute the errors of all or the named sources over a grid of the robot's coordinates, of any dimension.

    Poses instead of a grid give a dataset along one dimension, `pose`. The dataset is NaN where a pose of the grid
    breaks a limit; it has `tip_rms`, `worst_tip`, `left_rms` and `energy` of all sources combined,
    `tip_rms_<source>` of each source, `least_sensitive` (the best fifth of the poses) and, for a grid,
    `broken_limits`. Also returns the budget over the poses within the limits. `eta` weighs the orientation in the tip
    error [m/rad].

    Raises:
        UnreachablePoseError: no pose of the grid is within the limits.
        PM3DofError: see :func:`~pm3dof_pin.errors.error_budget.error_budget`.
    """
    robot = sources.robot
    if isinstance(grid, Poses):
        budget = error_budget(sources, grid, eta=eta, names=names)
        return _labelled(_table(budget), eta), budget
    poses, within = _poses_within_limits(robot, grid)
    budget = error_budget(sources, within, eta=eta, names=names)
    title = f"Errors of {robot.name} by all sources over {', '.join(grid.dims)}"
    return _labelled(_grid_arrays(grid, poses, _fields(budget), title).dataset(), eta), budget


def _table(budget: ErrorBudget) -> xr.Dataset:
    import xarray as xr

    robot, poses = budget.poses.robot, budget.poses
    labels = {
        c.name: ("pose", column, coordinate_attributes(c.name, c.unit, robot.name))
        for c, column in zip(robot.coordinates, poses.coordinates.T, strict=True)
    }
    variables = {name: ("pose", values, attributes) for name, (_, values, attributes) in _fields(budget).items()}
    return xr.Dataset(variables, coords=labels, attrs={"title": f"Errors of {robot.name}", "machine": robot.name})


def _fields(budget: ErrorBudget) -> dict[str, _Variable]:
    words = {
        "tip_rms": "tip error of all sources, root mean square over machines",
        "worst_tip": "tip error of all sources, bound",
        "left_rms": "tip error left with the best commands, root mean square over machines",
        "energy": "energy E of (8.15) of all sources, mean over machines",
    }
    found: dict[str, _Variable] = {
        name: ((), getattr(budget, name), {"units": "m", "long_name": text}) for name, text in words.items()
    }
    for source in budget.sources:
        words = {"long_name": f"tip error due to {source.long_name}", "error_class": source.error_class}
        found[f"tip_rms_{source.name}"] = ((), budget.select([source.name]).tip_rms, {"units": "m", **words})
    region = budget.least_sensitive().astype(float)
    found[LEAST_SENSITIVE] = ((), region, {"units": "1", "long_name": "region least sensitive to all sources"})
    return found


def _labelled(dataset: xr.Dataset, eta: float) -> xr.Dataset:
    return dataset.assign_attrs(_CHAPTER, eta_m_per_rad=eta, least_sensitive_part=LEAST_SENSITIVE_PART)


def _over(
    robot: Robot, grid: Grid, compute: Callable[[Poses], dict[str, Array]]
) -> Callable[[Array], dict[str, Array]]:
    """Return numbers as a function of points in a grid's coordinates, shape=(n, m); NaN beyond the limits."""
    complete = coordinates_over(robot, grid.dims, grid.fixed)

    def at(points: Array) -> dict[str, Array]:
        poses = robot.solve(complete(points.reshape(-1, len(grid.dims))), on_failure="nan")
        found = compute(poses[poses.within_limits])
        return {name: _spread(values, poses.within_limits) for name, values in found.items()}

    return at


def _spread(values: Array, within: Mask) -> Array:
    """Scatter values of the poses within the limits to their places, NaN elsewhere."""
    field = np.full((*within.shape, *values.shape[1:]), np.nan)
    field[within] = values
    return field


def _poses_within_limits(robot: Robot, grid: Grid) -> tuple[Poses, Poses]:
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


def _grid_arrays(grid: Grid, poses: Poses, variables: Mapping[str, _Variable], title: str) -> NamedArrays:
    """Return variables over a grid as a map, NaN beyond the limits, with `broken_limits` of its poses.

    Coordinates have their units; fixed ones are scalars.
    """
    robot, names = poses.robot, limit_names(poses.robot)
    fields = {
        name: NamedArray((*grid.dims, *own), _spread(values, poses.within_limits), own_attributes)
        for name, (own, values, own_attributes) in variables.items()
    }
    flags = flag_variable(grid.dims, poses.broken_limits, names, "limits that the pose breaks")
    coordinates = {
        c.name: NamedArray(
            (c.name,) if c.name in grid.axes else (),
            np.asarray(grid.axes.get(c.name, grid.fixed.get(c.name))),
            coordinate_attributes(c.name, c.unit, robot.name),
        )
        for c in grid.coordinates
    }
    return NamedArrays({**fields, BROKEN_LIMITS: flags}, coordinates, dataset_attributes(title, robot.name))
