"""The chapter's stiffness over a section z_e = constant, as a labelled map or as a function of the tilts."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.chapter.chapter_stiffness import AXES, UNITS, chapter_stiffness, global_index, require_above_clamp
from pm3dof_pin.chapter.limits import LIMIT_NAMES, limit_flags
from pm3dof_pin.chapter.tilt_grids import RectangularGrid
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.maps.datasets import BROKEN_LIMITS, NamedArray, NamedArrays, dataset_attributes, flag_variable
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

_LONG_NAMES = {
    "theta_x": "stiffness about theta_x",
    "theta_y": "stiffness about theta_y",
    "t_z": "stiffness along z",
    "t_x": "stiffness along x",
    "t_y": "stiffness along y",
    "theta_z": "stiffness about theta_z",
}


def stiffness_section(
    tripod: Tripod, grid: RectangularGrid | None = None, z_e: float | None = None, *, robot: Robot | None = None
) -> NamedArrays:
    """Compute the chapter's stiffness over a section of the workspace.

    Args:
        tripod: the machine.
        grid: the tilts; by default 6,561 poses.
        z_e: height of the section [m]; by default the middle height, the section of Table 8.3 and of Figs. 8.3 and 8.4.
        robot: the same machine as a robot, to compute with Pinocchio's Jacobians instead of the closed form.

    Returns:
        A map over theta_x and theta_y: `stiffness_<axis>` for the six axes of
        :data:`~pm3dof_pin.chapter.chapter_stiffness.AXES` and `stiffness_global` (their mean, of mixed units), NaN
        where a pose breaks a joint limit, and `broken_limits`, the sum of the
        :class:`~pm3dof_pin.chapter.limits.Limit` that it breaks. Units, long names and the meaning of the flags are
        attributes (CF conventions); `dataset()` gives the same as an `xarray.Dataset`.

    Raises:
        InvalidValueError: the height is not finite, or not above the clamp of the passive leg.
    """
    grid = RectangularGrid() if grid is None else grid
    height = tripod.middle_height if z_e is None else z_e
    poses, dims = grid.poses(height), ("theta_x", "theta_y")
    require_above_clamp(tripod, poses)
    flags = limit_flags(tripod, poses)
    variables = {
        name: NamedArray(dims, np.where(flags == 0, values, np.nan), _attributes(name))
        for name, values in _stiffness(tripod, poses, robot).items()
    }
    broken = flag_variable(dims, flags, LIMIT_NAMES, "joint limits that the pose breaks")
    coordinates = {
        f"theta_{axis}": NamedArray((dim,), values, _labels("rad", f"rotation of the platform about {axis}"))
        for axis, dim, values in zip("xy", dims, grid.axes, strict=True)
    }
    level = NamedArray((), np.asarray(height, dtype=float), _labels("m", "height of the tool point O_e"))
    name = tripod.parameters.name
    attributes = {
        **dataset_attributes(f"Stiffness of {name} over a section of its workspace, chapter model", name),
        "model": "chapter",
        "references": "D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.2.3",
    }
    return NamedArrays(variables | {BROKEN_LIMITS: broken}, coordinates | {"z_e": level}, attributes)


def section_values(tripod: Tripod, z_e: float, variable: str) -> Callable[[Array], Array]:
    """Return a variable of :func:`stiffness_section` as a function of tilts, shape=(n, 2) to (n,), within limits."""
    return lambda tilts: _stiffness(tripod, np.column_stack([tilts, np.full(len(tilts), z_e)]), None)[variable]


def _stiffness(tripod: Tripod, poses: Array, robot: Robot | None) -> dict[str, Array]:
    """Return the values of every variable, NaN out of reach."""
    if robot is None:
        diagonal = chapter_stiffness(tripod, poses, on_failure="nan")
    else:
        from pm3dof_pin.chapter.pinocchio_stiffness import pinocchio_stiffness  # loading Pinocchio is slow

        diagonal = pinocchio_stiffness(robot, tripod, poses, on_failure="nan")
    by_axis = {f"stiffness_{axis}": diagonal[..., k] for k, axis in enumerate(AXES)}
    return by_axis | {"stiffness_global": global_index(diagonal)}


def _attributes(variable: str) -> dict[str, str]:
    axis = variable.removeprefix("stiffness_")
    if axis != "global":
        return _labels(UNITS[axis], _LONG_NAMES[axis])
    comment = "adds N/m and N m/rad, as the chapter does; its value depends on the unit of length"
    return {**_labels("mixed", "global stiffness, the mean of the six diagonal entries"), "comment": comment}


def _labels(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}
