"""Tool errors as map quantities: from geometry, from temperature, and from all sources, separate and combined.

Those from geometry are reduced inside a compiled program, those from temperature come from the sensitivities of one;
weight and vibration take milliseconds per pose.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import attrgetter
from weakref import WeakKeyDictionary

import numpy as np

from pm3dof_pin.errors.error_budget import TOGETHER, ErrorBudget, error_budget
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.error_sums import KinematicSum, kinematic_sum
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.maps.quantities import Dimension, Evaluation, MappedRobot, has_drives_and_tool, quantity
from pm3dof_pin.typing import Array

_CHUNK = 8192  # poses at a time: each has a few hundred numbers of effects

_sources: WeakKeyDictionary[MappedRobot, ErrorSources] = WeakKeyDictionary()


def _sources_of(mapped: MappedRobot) -> ErrorSources:
    """Return the sources of a robot with the magnitudes of its error file, cached."""
    if mapped not in _sources:
        robot = mapped.robot
        declared = GeometricErrors(robot) if robot.files is None else GeometricErrors.of(robot, robot.files.errors)
        _sources[mapped] = ErrorSources(closable(declared))
    return _sources[mapped]


def _source_names(mapped: MappedRobot) -> tuple[str, ...]:
    """Return the names of the sources, and of their combination."""
    sources = _sources_of(mapped)
    return (
        *(source.name for source in sources.at(reachable_poses(sources.robot, 1, np.random.default_rng(0)))),
        TOGETHER,
    )


_Reading = Callable[[ErrorBudget], Array]


def _over(evaluation: Evaluation, classes: tuple[str, ...], read: _Reading, shape: tuple[int, ...] = ()) -> Array:
    """Read numbers from the budgets of some source classes at all poses, NaN where there are none."""
    poses, sources = evaluation.poses, _sources_of(evaluation.mapped)
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
    return kinematic_sum(_sources_of(evaluation.mapped), evaluation.poses, name, **evaluation.batch).values


_SUMS: dict[str, tuple[KinematicSum, str]] = {
    "geometric_error": ("tip_rms", "tip error due to geometry, root mean square over machines"),
    "geometric_error_bound": ("worst_tip", "bound of the tip error due to geometry"),
    "geometric_error_left": ("left_rms", "tip error due to geometry that no command can undo, root mean square"),
    "geometric_error_energy": ("energy", "energy E of (8.15) of the pose error due to geometry, mean"),
}
for _name, (_sum, _long_name) in _SUMS.items():
    quantity(_name, unit="m", long_name=_long_name, exists=has_drives_and_tool)(partial(_kinematic, name=_sum))


@quantity(
    "thermal_error", unit="m", long_name="tip error due to temperature, root mean square", exists=has_drives_and_tool
)
def _thermal_error(evaluation: Evaluation) -> Array:
    return _over(evaluation, ("thermal",), attrgetter("tip_rms"))


@quantity(
    "error_budget",
    dims=(Dimension("error_source", _source_names),),
    unit="m",
    long_name="tip error due to each source and to all combined, root mean square",
    exists=has_drives_and_tool,
)
def _error_budget(evaluation: Evaluation) -> Array:
    names = _source_names(evaluation.mapped)

    def read(budget: ErrorBudget) -> Array:
        apart = [budget.select([name]).tip_rms for name in budget.names]
        return np.stack([*apart, budget.tip_rms], axis=-1)

    return _over(evaluation, (), read, (len(names),))
