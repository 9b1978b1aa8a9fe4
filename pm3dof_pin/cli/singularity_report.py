"""Distance of a configuration to singularities, as commands report it."""

from __future__ import annotations

from typing import Any

from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.singularity import singularities, singularity_distances
from pm3dof_pin.mechanism.configuration import Configuration


def read_singularity_distances(configuration: Configuration) -> dict[str, Any] | None:
    """Return measure, tool twist and whether singular, by type; None without a tool or a generic configuration."""
    if configuration.mechanism.tool_frame is None:
        return None
    try:
        generic = instantaneous_mobility(generic_configuration(configuration))
        found = singularity_distances(configuration, generic=generic)
        singular = {entry.type for entry in singularities(configuration, generic=generic)}
    except PM3DofError:
        return None
    return {
        entry.type: {"measure": entry.measure, "twist": entry.twist, "singular": entry.type in singular}
        for entry in found
    }


def singularity_line(distances: dict[str, Any] | None) -> list[str]:
    """Return a text line, or none if nothing is known."""
    if not distances:
        return []
    listed = ", ".join(
        f"{kind} {'0 (SINGULAR)' if entry['singular'] else format(entry['measure'], '.4g')}"
        for kind, entry in distances.items()
    )
    return [f"distance to singularities (least scaled singular values): {listed}"]
