"""Mesh files of a robot: found where its URDF says, and given names of their own in the folder of an export."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pm3dof_pin.exceptions import DescriptionError

FOLDER = "meshes"


class Meshes:
    """The meshes that a URDF names.

    Args:
        urdf: the URDF; relative names count from its folder, `package://x/` from the folder `x` that it is in.
        names: file names as written in it.

    Attributes:
        copies: path of each file, by its path in the folder of an export.

    Raises:
        DescriptionError: a file is not there.
    """

    def __init__(self, urdf: Path, names: Iterable[str]) -> None:
        self.copies: dict[str, Path] = {}
        self._exported: dict[str, str] = {}
        for name in dict.fromkeys(names):
            self._add(name, _found(urdf, name))

    def __len__(self) -> int:
        return len(self.copies)

    def exported(self, name: str) -> str:
        """Return the path of a mesh in the folder of an export, such as `meshes/arm.stl`."""
        return self._exported[name]

    def _add(self, name: str, path: Path) -> None:
        candidates = [path.name, *(f"{path.stem}_{number}{path.suffix}" for number in range(2, len(self.copies) + 3))]
        target = next(
            target
            for target in (f"{FOLDER}/{candidate}" for candidate in candidates)
            if self.copies.get(target, path) == path
        )
        self.copies[target] = path
        self._exported[name] = target


def _found(urdf: Path, name: str) -> Path:
    folders = [urdf.absolute().parent]
    relative = name.removeprefix("file://")
    if name.startswith("package://"):
        package, _, relative = name.removeprefix("package://").partition("/")
        folders = [folder / package for folder in folders[0].parents] + [
            folder for folder in [folders[0], *folders[0].parents] if folder.name == package
        ]
    for folder in folders:
        if (path := folder / relative).is_file():
            return path.resolve()
    raise DescriptionError(urdf, f"mesh '{name}'", "expected a file that exists")
