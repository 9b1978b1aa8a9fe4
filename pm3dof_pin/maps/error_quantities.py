"""Tool errors as map quantities: from geometry, from temperature, and from all sources, separate and combined.

Those from geometry are reduced inside a compiled program, those from temperature come from the sensitivities of one;
weight and vibration take milliseconds per pose.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import attrgetter

import numpy as np

from pm3dof_pin.errors.error_budget import TOGETHER, ErrorBudget, error_budget
from pm3dof_pin.errors.error_sums import KinematicSum, kinematic_sum
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.maps.quantity import Dimension, Evaluation, MappedRobot, Quantity
from pm3dof_pin.maps.robot_quantities import drives_hold_tool
from pm3dof_pin.typing import Array

_CHUNK = 8192  # poses at a time: each has a few hundred numbers of effects


def _source_names(mapped: MappedRobot) -> tuple[str, ...]:
    """Return the names of the sources, and of their combination."""
    sources = mapped.error_sources
    return (
        *(source.name for source in sources.at(reachable_poses(sources.robot, 1, np.random.default_rng(0)))),
        TOGETHER,
    )


_Reading = Callable[[ErrorBudget], Array]


def _over(evaluation: Evaluation, classes: tuple[str, ...], read: _Reading, shape: tuple[int, ...] = ()) -> Array:
    """Read numbers from the budgets of some source classes at all poses, NaN where there are none."""
    poses, sources = evaluation.poses, evaluation.mapped.error_sources
    values = np.full((int(np.prod(poses.shape)), *shape), np.nan)
    flat = poses.reshape(len(values))
    solved = np.flatnonzero(flat.solved)
    for start in range(0, len(solved), _CHUNK):
        rows = solved[start : start + _CHUNK]
        values[rows] = _read(sources, flat[rows], classes, read, shape)
    return values.reshape(*poses.shape, *shape)


def _read(
    sources: ErrorSources, poses: Poses, classes: tuple[str, ...], read: _Reading, shape: tuple[int, ...]
) -> Array:
    try:
        return read(error_budget(sources, poses, names=classes))
    except PM3DofError:
        if len(poses) == 1:  # a singular pose
            return np.full((1, *shape), np.nan)
    return np.concatenate([_read(sources, poses[[row]], classes, read, shape) for row in range(len(poses))])


def _kinematic(evaluation: Evaluation, name: KinematicSum) -> Array:
    """Return a sum over geometric errors."""
    return kinematic_sum(evaluation.mapped.error_sources, evaluation.poses, name, **evaluation.batch).values


def _error_budget(evaluation: Evaluation) -> Array:
    names = _source_names(evaluation.mapped)

    def read(budget: ErrorBudget) -> Array:
        apart = [budget.select([name]).tip_rms for name in budget.names]
        return np.stack([*apart, budget.tip_rms], axis=-1)

    return _over(evaluation, (), read, (len(names),))


_SUMS: tuple[tuple[str, KinematicSum, str], ...] = (
    ("geometric_error", "tip_rms", "tip error due to geometry, root mean square over machines"),
    ("geometric_error_bound", "worst_tip", "bound of the tip error due to geometry"),
    ("geometric_error_left", "left_rms", "tip error due to geometry that no command can undo, root mean square"),
    ("geometric_error_energy", "energy", "energy E of (8.15) of the pose error due to geometry, mean"),
)

ERROR_QUANTITIES = (
    *(
        Quantity(name, partial(_kinematic, name=kind), "m", long_name, exists=drives_hold_tool)
        for name, kind, long_name in _SUMS
    ),
    Quantity(
        "thermal_error",
        lambda evaluation: _over(evaluation, ("thermal",), attrgetter("tip_rms")),
        "m",
        "tip error due to temperature, root mean square",
        exists=drives_hold_tool,
    ),
    Quantity(
        "error_budget",
        _error_budget,
        "m",
        "tip error due to each source and to all combined, root mean square",
        (Dimension("error_source", _source_names),),
        drives_hold_tool,
    ),
)
"""Tool errors of robots with drives and a tool."""
