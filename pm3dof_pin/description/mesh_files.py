"""Mesh files of every kind (STL, OBJ, Collada, ...), read as surfaces of triangles."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pm3dof_pin.exceptions import DescriptionError

if TYPE_CHECKING:
    import trimesh


def read_meshes(path: Path | str) -> list[trimesh.Trimesh]:
    """Read a file of meshes, each placed where the file has it.

    Args:
        path: the file.

    Raises:
        DescriptionError: it cannot be read.
    """
    import trimesh

    try:
        meshes = trimesh.load_scene(path).dump()
    except Exception as error:  # trimesh's readers raise what they like
        reason = " ".join(str(error).split())
        raise DescriptionError(path, "mesh", f"expected a mesh that can be read ({reason})") from error
    return [mesh for mesh in meshes if isinstance(mesh, trimesh.Trimesh)]
