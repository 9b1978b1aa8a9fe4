"""Stiffness over a section z_e = constant, or over several, as a labelled dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter.chapter_stiffness import AXES, UNITS, chapter_stiffness, global_index, require_above_clamp
from pm3dof_pin.chapter.limits import LIMIT_NAMES, limit_flags
from pm3dof_pin.chapter.tilt_grids import PointGrid, PolarGrid, RectangularGrid, TiltGrid
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.chapter.workspace import tripod_space
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.maps.labels import BROKEN_LIMITS, dataset_attributes, flag_attributes
from pm3dof_pin.maps.named_arrays import NamedArray, NamedArrays
from pm3dof_pin.maps.workspace_section import workspace_section
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr

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
    tripod: Tripod,
    grid: TiltGrid | None = None,
    z_e: ArrayLike | None = None,
    *,
    excluded: Literal["nan", "keep"] = "nan",
    robot: Robot | None = None,
) -> xr.Dataset:
    """Compute the chapter's stiffness over a section of the workspace.

    Args:
        tripod: the machine.
        grid: the tilts; by default the rectangular grid of 6,561 poses.
        z_e: height of the section, or several heights, shape=(k,) [m]; by default the middle height, the section of
            Table 8.3 and of Figs. 8.3 and 8.4.
        excluded: what stands where a pose breaks a joint limit: "nan", or "keep" for the value of the formula (which is
            NaN still where a link does not meet its guideway).
        robot: the same machine as a robot, to compute with Pinocchio's Jacobians instead of the closed form.

    Returns:
        A dataset over the dimensions of the grid, with z_e in front if several heights are given: `stiffness_<axis>`
        for the six axes of :data:`~pm3dof_pin.chapter.chapter_stiffness.AXES`, `stiffness_global` (their mean, of mixed
        units), and `broken_limits`, the sum of the :class:`~pm3dof_pin.chapter.limits.Limit` that a pose breaks. Units,
        long names and the meaning of the flags are attributes (CF conventions).

    Raises:
        InvalidValueError: a height is not finite, not above the clamp of the passive leg, or heights of two dimensions.
    """
    return section_arrays(tripod, grid, z_e, excluded=excluded, robot=robot).dataset()


def section_arrays(
    tripod: Tripod,
    grid: TiltGrid | None = None,
    z_e: ArrayLike | None = None,
    *,
    excluded: Literal["nan", "keep"] = "nan",
    robot: Robot | None = None,
) -> NamedArrays:
    """Compute what :func:`stiffness_section` returns."""
    grid = RectangularGrid() if grid is None else grid
    heights = np.asarray(tripod.middle_height if z_e is None else z_e, dtype=float)
    if heights.ndim > 1:
        raise InvalidValueError("z_e", f"an array of shape {heights.shape}", "one height or a list of heights")
    poses = grid.poses(heights)
    require_above_clamp(tripod, poses)
    flags = limit_flags(tripod, poses)
    dims = (("z_e",) if heights.ndim else ()) + grid.dims
    variables = {
        name: NamedArray(dims, values if excluded == "keep" else np.where(flags == 0, values, np.nan), attributes)
        for name, (values, attributes) in _chapter_variables(tripod, poses, robot).items()
    }
    broken = NamedArray(dims, flags, flag_attributes(LIMIT_NAMES, "joint limits that the pose breaks"))
    coordinates = {n: NamedArray(c.dims, c.values, _labels(c.unit, c.long_name)) for n, c in grid.coordinates().items()}
    level = NamedArray(dims[:1] if heights.ndim else (), heights, _labels("m", "height of the tool point O_e"))
    return NamedArrays(variables | {BROKEN_LIMITS: broken}, coordinates | {"z_e": level}, _attributes(tripod))


def section_outline(
    tripod: Tripod,
    grid: RectangularGrid | PolarGrid | None = None,
    z_e: float | None = None,
    directions: int = 720,
    *,
    robot: Robot | None = None,
) -> xr.Dataset | None:
    """Compute the chapter's stiffness along the boundary of a section: of its reachable part that the grid covers.

    A picture that ends there has a smooth edge. The dataset is like that of :func:`stiffness_section` along the
    dimension `point`, going round the level platform, with `at_grid_end` where the grid ends before a limit does. None
    if there is no such single line: the reachable part is not star-shaped about the level platform, or the grid does
    not contain it.
    """
    height = tripod.middle_height if z_e is None else z_e
    section = workspace_section(tripod_space(tripod), height, directions)
    edge = (RectangularGrid() if grid is None else grid).edge_radius(section.azimuths)
    if not section.star_shaped or not np.all(edge > 0.0):
        return None
    radii = np.minimum(section.radii, edge)
    tilts = radii[:, None] * np.stack([np.cos(section.azimuths), np.sin(section.azimuths)], axis=-1)
    outline = stiffness_section(tripod, PointGrid(tilts), section.level, robot=robot)
    return outline.assign(
        at_grid_end=("point", edge < section.radii, {"long_name": "the grid ends here, and no limit"})
    )


def _chapter_variables(tripod: Tripod, poses: Array, robot: Robot | None) -> dict[str, tuple[Array, dict[str, str]]]:
    """Values and attributes of every variable of the chapter's model."""
    if robot is None:
        diagonal = chapter_stiffness(tripod, poses, on_failure="nan")
    else:
        from pm3dof_pin.chapter.pinocchio_stiffness import pinocchio_stiffness  # loading Pinocchio takes long

        diagonal = pinocchio_stiffness(robot, tripod, poses, on_failure="nan")
    variables = {
        f"stiffness_{axis}": (diagonal[..., k], _labels(UNITS[axis], _LONG_NAMES[axis])) for k, axis in enumerate(AXES)
    }
    mixed = _labels("mixed", "global stiffness, the mean of the six diagonal entries")
    mixed["comment"] = "adds N/m and N m/rad, as the chapter does; its value depends on the unit of length"
    variables["stiffness_global"] = (global_index(diagonal), mixed)
    return variables


def _labels(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}


def _attributes(tripod: Tripod) -> dict[str, str]:
    title = f"Stiffness of {tripod.parameters.name} over a section of its workspace, chapter model"
    return {
        **dataset_attributes(title, tripod.parameters.name),
        "model": "chapter",
        "references": "D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.2.3",
    }
