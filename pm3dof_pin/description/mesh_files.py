"""Mesh files (STL, OBJ, Collada, ...), read as triangle meshes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pm3dof_pin.description.own_files import MANIFEST, is_within, require_own
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.exceptions import DescriptionError

if TYPE_CHECKING:
    import trimesh


_KINDS = {".stl", ".obj", ".dae", ".ply", ".off", ".gltf", ".glb", ".3mf", ".3ds", ".wrl", ".msh", ".x3d", ".iv"}
_MOST_BYTES = 512 * 2**20


def find_mesh(files: RobotFiles, name: str) -> Path:
    """Find a mesh by its name in a URDF: relative to the robot's folder, or `package://x/`.

    Only mesh files in the robot's own folder, the named package or the package paths are accepted, after following
    symbolic links.

    Raises:
        DescriptionError: the file is missing, is not a mesh, or lies outside the folders of the robot.
    """
    place, found = f"mesh '{name}'", [(path, own) for path, own in _candidates(files, name) if path.is_file()]
    if not found:
        raise DescriptionError(files.path, place, "expected an existing file")
    path, own = next(((path, own) for path, own in found if is_within(path, own)), found[0])
    require_own(path, own, files.path, place)
    if path.suffix.lower() not in _KINDS:
        raise DescriptionError(files.path, place, f"expected a file of type {', '.join(sorted(_KINDS))}")
    if path.stat().st_size > _MOST_BYTES:
        raise DescriptionError(files.path, place, f"expected no more than {_MOST_BYTES >> 20} MiB")
    return path.resolve()


def _candidates(files: RobotFiles, name: str) -> Iterator[tuple[Path, Sequence[Path]]]:
    """Yield candidate paths of a mesh, each with the folders it must be in to be accepted."""
    folder = files.path.absolute().parent
    if not name.startswith("package://"):
        for start in (folder, *files.own_folders, *files.package_paths):
            yield start / name.removeprefix("file://"), files.own_folders
        return
    package, _, relative = name.removeprefix("package://").partition("/")
    is_name = package not in ("", ".", "..")
    for above in (*files.package_paths, *folder.parents):
        is_package = is_name and (above in files.own_folders or (above / package / MANIFEST).is_file())
        yield above / package / relative, [*files.own_folders, *([above / package] if is_package else [])]
    for above in (*files.package_paths, folder, *folder.parents):
        if above.name == package:
            yield above / relative, [above, *files.own_folders]


def read_meshes(path: Path | str) -> list[trimesh.Trimesh]:
    """Read the meshes of a file, placed as in the file; DescriptionError if that fails."""
    import trimesh

    try:
        meshes = trimesh.load_scene(path).dump()
    except Exception as error:  # trimesh's readers may raise anything
        reason = " ".join(str(error).split())
        raise DescriptionError(path, "mesh", f"expected a readable mesh ({reason})") from error
    return [mesh for mesh in meshes if isinstance(mesh, trimesh.Trimesh)]
