"""Errors of the tool over a section z_e = constant of the tripod's workspace, as a labelled dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import pm3dof_pin
from pm3dof_pin.chapter.limits import LIMIT_NAMES, broken_limits
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.errors.error_map import ErrorMap, error_map
from pm3dof_pin.errors.error_parameters import Distribution, GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.maps.grid import FilledGrid, Grid, PointGrid, RectangularGrid
from pm3dof_pin.maps.limit_flags import BROKEN_LIMITS, flag_attributes
from pm3dof_pin.maps.section import section_outline
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


MOTION_COORDINATES = ("platform_x_joint", "platform_y_joint", "passive_slider_joint")
QUANTITIES = {
    "tip_rms": ("m", "tip error, root mean square over machines within their tolerances"),
    "compensable_rms": ("m", "tip error that commands can undo, root mean square"),
    "uncompensable_rms": ("m", "tip error that no command can undo, root mean square"),
    "worst_tip": ("m", "bound of the tip error, for all machines within their tolerances"),
    "position_rms": ("m", "position error, root mean square"),
    "orientation_rms": ("rad", "orientation error, root mean square"),
}


def error_section(
    tripod: Tripod,
    errors: GeometricErrors,
    grid: Grid | None = None,
    z_e: float | None = None,
    *,
    eta: float = TIP_LENGTH,
    distribution: Distribution = "normal",
) -> tuple[xr.Dataset, ErrorMap]:
    """Compute the first-order errors of the tool over a section of the workspace.

    Args:
        tripod: the machine in closed form, for its limits.
        errors: error parameters of the same machine.
        grid: the tilts; by default a rectangular grid over +-40 deg in steps of 2 deg.
        z_e: height of the section [m]; by default the middle height.
        eta: weight of the orientation in the tip error [m/rad].
        distribution: what the tolerances are.

    Returns:
        A dataset over the dimensions of the grid with the variables of :data:`QUANTITIES`, NaN where a pose breaks a
        joint limit, and `broken_limits`; and the error map over the poses within the limits, in the order of the grid.

    Raises:
        InvalidValueError: the errors are those of another kind of machine.
        UnreachablePoseError: no pose of the section is within the limits.
    """
    import xarray as xr

    if errors.mechanism.motion_coordinates != MOTION_COORDINATES:
        raise InvalidValueError("errors", errors, f"those of a tripod, with the joints {', '.join(MOTION_COORDINATES)}")
    grid = RectangularGrid(shape=(41, 41)) if grid is None else grid
    height = tripod.middle_height if z_e is None else float(z_e)
    poses = grid.poses(height)
    flags = broken_limits(tripod, poses)
    within = flags == 0
    if not within.any():
        raise UnreachablePoseError(f"no pose of the section z_e = {height:g} m is within the joint limits")
    result = error_map(errors, errors.mechanism.solve(poses[within]), eta=eta, distribution=distribution)
    variables = {
        name: (grid.dims, _spread(within, getattr(result, name)), {"units": unit, "long_name": long_name})
        for name, (unit, long_name) in QUANTITIES.items()
    }
    dataset = xr.Dataset(
        variables
        | {BROKEN_LIMITS: (grid.dims, flags, flag_attributes(LIMIT_NAMES, "joint limits that the pose breaks"))},
        coords={
            **{
                name: (c.dims, c.values, {"units": c.unit, "long_name": c.long_name})
                for name, c in grid.coordinates().items()
            },
            "z_e": ((), height, {"units": "m", "long_name": "height of the tool point O_e"}),
        },
        attrs={
            "Conventions": "CF-1.8",
            "title": f"First-order errors of {tripod.parameters.name} over a section of its workspace",
            "machine": tripod.parameters.name,
            "model": "error",
            "eta_m_per_rad": eta,
            "distribution": distribution,
            "source": f"pm3dof-pin {pm3dof_pin.__version__}",
            "references": "D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.3",
        },
    )
    return dataset, result


def error_outline(
    tripod: Tripod, errors: GeometricErrors, grid: FilledGrid | None = None, section: xr.Dataset | None = None
) -> xr.Dataset | None:
    """Compute the errors along the edge of a section, for a picture that ends there smoothly.

    Args:
        tripod: the machine in closed form.
        errors: error parameters of the same machine.
        grid: the grid of the section that is shown.
        section: result of :func:`error_section`, whose height, eta and distribution are taken.

    Returns:
        A dataset along the dimension `point`, or None where :func:`~pm3dof_pin.maps.section.section_outline` has none.
    """
    height = None if section is None else float(section["z_e"])
    outline = section_outline(tripod, RectangularGrid(shape=(41, 41)) if grid is None else grid, height, 240)
    if outline is None:
        return None
    points = PointGrid(np.stack([outline["theta_x"].values, outline["theta_y"].values], axis=-1))
    eta = TIP_LENGTH if section is None else float(section.attrs["eta_m_per_rad"])
    distribution: Distribution = "normal" if section is None else section.attrs["distribution"]
    return error_section(tripod, errors, points, height, eta=eta, distribution=distribution)[0]


def _spread(within: NDArray[np.bool_], values: Array) -> Array:
    spread = np.full(within.shape, np.nan)
    spread[within] = values
    return spread
