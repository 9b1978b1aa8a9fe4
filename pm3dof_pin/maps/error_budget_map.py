"""All sources of error over a section or the whole workspace of any robot, as a labelled dataset."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.errors.error_budget import ErrorBudget, error_budget
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.errors.tool_errors import LEAST_SENSITIVE_PART
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Poses, Robot
from pm3dof_pin.maps.grid_map import Variable, grid_dataset, poses_within_limits
from pm3dof_pin.maps.labels import coordinate_attributes

if TYPE_CHECKING:
    import xarray as xr

LEAST_SENSITIVE = "least_sensitive"
"""Variable that is 1 in the region least sensitive to errors, 0 elsewhere."""

_MOST_POSES = 200_000


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
    if points ** len(limited) > _MOST_POSES:
        most = math.floor(_MOST_POSES ** (1.0 / len(limited)) + 1e-9)
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
    poses, within = poses_within_limits(robot, grid)
    budget = error_budget(sources, within, eta=eta, names=names)
    title = f"Errors of {robot.name} by all sources over {', '.join(grid.dims)}"
    return _labelled(grid_dataset(grid, poses, _fields(budget), title), eta), budget


def _table(budget: ErrorBudget) -> xr.Dataset:
    import xarray as xr

    robot, poses = budget.poses.robot, budget.poses
    labels = {
        c.name: ("pose", column, coordinate_attributes(c.name, c.unit, robot.name))
        for c, column in zip(robot.coordinates, poses.coordinates.T, strict=True)
    }
    variables = {name: ("pose", values, attributes) for name, (_, values, attributes) in _fields(budget).items()}
    return xr.Dataset(variables, coords=labels, attrs={"title": f"Errors of {robot.name}", "machine": robot.name})


def _fields(budget: ErrorBudget) -> dict[str, Variable]:
    words = {
        "tip_rms": "tip error of all sources, root mean square over machines",
        "worst_tip": "tip error of all sources, bound",
        "left_rms": "tip error left with the best commands, root mean square over machines",
        "energy": "energy E of (8.15) of all sources, mean over machines",
    }
    found: dict[str, Variable] = {
        name: ((), getattr(budget, name), {"units": "m", "long_name": text}) for name, text in words.items()
    }
    for source in budget.sources:
        words = {"long_name": f"tip error due to {source.long_name}", "error_class": source.error_class}
        found[f"tip_rms_{source.name}"] = ((), budget.select([source.name]).tip_rms, {"units": "m", **words})
    region = budget.least_sensitive().astype(float)
    found[LEAST_SENSITIVE] = ((), region, {"units": "1", "long_name": "region least sensitive to all sources"})
    return found


def _labelled(dataset: xr.Dataset, eta: float) -> xr.Dataset:
    return dataset.assign_attrs(
        model="error",
        eta_m_per_rad=eta,
        least_sensitive_part=LEAST_SENSITIVE_PART,
        references="D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.3",
    )
