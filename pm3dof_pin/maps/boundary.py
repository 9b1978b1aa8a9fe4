"""The boundary of the reachable set as a labelled dataset: where it runs, and which limit makes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.maps.labels import coordinate_attributes, dataset_attributes, flag_attributes, flag_type
from pm3dof_pin.maps.workspace import Workspace

if TYPE_CHECKING:
    import xarray as xr


def workspace_boundary(workspace: Workspace) -> xr.Dataset:
    """Return the boundary points of all sections over `point`: their coordinates [m, rad] and `binding_limits`.

    These are sums of the limits that end the reachable set there.
    """
    import xarray as xr

    space = workspace.space
    points = np.concatenate([section.points for section in workspace.sections])
    levels = np.repeat(workspace.levels, [len(section.rays) for section in workspace.sections])
    limits = np.concatenate([section.limits for section in workspace.sections]).astype(flag_type(space.limits))
    columns = np.column_stack([points, levels])[:, : len(space.names)]
    return xr.Dataset(
        {"binding_limits": ("point", limits, flag_attributes(space.limits, "limits that end the reachable set"))},
        coords={
            name: ("point", column, coordinate_attributes(name, unit, space.machine))
            for name, unit, column in zip(space.names, space.units, columns.T, strict=True)
        },
        attrs=dataset_attributes(f"Boundary of the workspace of {space.machine} under its limits", space.machine),
    )
