"""What commands say of how far a configuration is from singular ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pm3dof_pin.mechanism.configuration import Configuration


def read_singularity_distances(configuration: Configuration) -> dict[str, Any] | None:
    """Return measure and tool twist by type of singularity; None without a tool, or where nothing generic is near."""
    from pm3dof_pin.exceptions import PM3DofError
    from pm3dof_pin.kinematics.singularity import singularity_distances

    if configuration.mechanism.tool_frame is None:
        return None
    try:
        found = singularity_distances(configuration)
    except PM3DofError:
        return None
    return {entry.type: {"measure": entry.measure, "twist": entry.twist} for entry in found}


def singularity_line(distances: dict[str, Any] | None) -> list[str]:
    """Return one line for a person; none where nothing is known."""
    if not distances:
        return []
    listed = ", ".join(f"{kind} {entry['measure']:.4g}" for kind, entry in distances.items())
    return [f"distance to singularities (least scaled singular values): {listed}"]
