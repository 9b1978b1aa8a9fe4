"""Mesh files of a robot: found as named in its URDF, and given unique names in the folder of an export.

Files that a tool cannot read are rewritten as OBJ with the same triangles.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path, PurePath

from pm3dof_pin.description.mesh_files import find_mesh, read_meshes
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.xml_text import numbers_text
from pm3dof_pin.files import write_atomically

FOLDER = "meshes"

_REWRITTEN = ".obj"  # every tool reads it


class Meshes:
    """The meshes of a URDF, by their names in it, for a tool that reads certain file types.

    Attributes:
        copies: path of each file, by its path in the folder of an export.
    """

    def __init__(self, sources: Mapping[str, Path], kinds: Collection[str] | None = None) -> None:
        self._sources = dict(sources)
        self._kinds = kinds
        self.copies: dict[str, Path] = {}
        self._exported: dict[str, str] = {}
        for name, path in self._sources.items():
            self._add(name, path)

    @classmethod
    def from_urdf(cls, files: RobotFiles, names: Iterable[str]) -> Meshes:
        """Find the meshes of a URDF, see :func:`~pm3dof_pin.description.mesh_files.find_mesh`."""
        return cls({name: find_mesh(files, name) for name in dict.fromkeys(names)})

    def __len__(self) -> int:
        return len(self.copies)

    def for_kinds(self, kinds: Collection[str]) -> Meshes:
        """Return the meshes for a tool that reads only certain suffixes; the others become OBJ files."""
        return Meshes(self._sources, kinds)

    def exported(self, name: str) -> str:
        """Return the path of a mesh in the folder of an export, such as `meshes/arm.stl`."""
        return self._exported[name]

    def write(self, folder: Path) -> list[Path]:
        """Write the files into the folder of an export, and return their paths.

        Raises:
            DescriptionError: a file to be rewritten cannot be read.
            OutputError: a file cannot be written.
        """
        written = []
        for target, source in self.copies.items():
            same = PurePath(target).suffix == source.suffix
            content = source.read_bytes() if same else _as_obj(source)
            with write_atomically(folder / target) as temporary:
                temporary.write_bytes(content)
            written.append(folder / target)
        return written

    def _add(self, name: str, path: Path) -> None:
        kind = path.suffix if self._kinds is None or path.suffix.lower() in self._kinds else _REWRITTEN
        numbered = (f"{path.stem}_{number}{kind}" for number in range(2, len(self.copies) + 3))
        target = next(
            target
            for target in (f"{FOLDER}/{candidate}" for candidate in (f"{path.stem}{kind}", *numbered))
            if self.copies.get(target, path) == path
        )
        self.copies[target] = path
        self._exported[name] = target


def _as_obj(path: Path) -> bytes:
    """Read a mesh file and write its triangles as one OBJ, without colours."""
    lines: list[str] = []
    vertices = 0
    for mesh in read_meshes(path):
        lines += [f"v {numbers_text(vertex)}" for vertex in mesh.vertices.tolist()]
        lines += ["f {} {} {}".format(*corners) for corners in (mesh.faces + 1 + vertices).tolist()]
        vertices += len(mesh.vertices)
    if not lines:
        raise DescriptionError(path, "mesh", "expected triangles")
    return ("\n".join(lines) + "\n").encode()
