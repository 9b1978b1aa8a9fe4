"""The boundary of the reachable set as a labelled dataset: where it runs, and which limit makes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import pm3dof_pin
from pm3dof_pin.chapter.limits import LIMIT_NAMES
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.maps.limit_flags import flag_attributes
from pm3dof_pin.workspace import Workspace

if TYPE_CHECKING:
    import xarray as xr


def workspace_boundary(tripod: Tripod, workspace: Workspace) -> xr.Dataset:
    """Return the boundary points of all sections of a workspace.

    Args:
        tripod: the machine.
        workspace: its reachable set.

    Returns:
        A dataset over `point` with the coordinates theta_x, theta_y [rad] and z_e [m] and the variable
        `binding_limits`, the sum of the :class:`~pm3dof_pin.chapter.limits.Limit` that end the reachable set there.
    """
    import xarray as xr

    tilts = np.concatenate([section.tilts for section in workspace.sections])
    heights = np.repeat(workspace.heights, [len(section.rays) for section in workspace.sections])
    limits = np.concatenate([section.limits for section in workspace.sections])
    attributes = flag_attributes(LIMIT_NAMES, "joint limits that end the reachable set here")
    return xr.Dataset(
        {"binding_limits": ("point", limits, attributes)},
        coords={
            "theta_x": ("point", tilts[:, 0], {"units": "rad", "long_name": "rotation of the platform about x"}),
            "theta_y": ("point", tilts[:, 1], {"units": "rad", "long_name": "rotation of the platform about y"}),
            "z_e": ("point", heights, {"units": "m", "long_name": "height of the tool point O_e"}),
        },
        attrs={
            "Conventions": "CF-1.8",
            "title": f"Boundary of the workspace of {tripod.parameters.name} under its joint limits",
            "machine": tripod.parameters.name,
            "source": f"pm3dof-pin {pm3dof_pin.__version__}",
        },
    )
