"""Which files belong to a description: those of its package and of the packages given."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pm3dof_pin.exceptions import DescriptionError

MANIFEST = "package.xml"
"""The file that marks a ROS package."""

_PARTS = ("urdf", "xacro", "robots", "mjcf", "sdf", "xml", "srdf")
_MAX_LEVELS = 4  # how far above a file its package is searched


def package_of(path: Path) -> Path:
    """Return the folder of a description's own files.

    This is the nearest folder above the file with a package.xml; otherwise the file's own folder, or its parent if
    that is named urdf, xacro, robots, mjcf, sdf, xml or srdf.
    """
    folder = path.resolve().parent
    for candidate in (folder, *list(folder.parents)[:_MAX_LEVELS]):
        if (candidate / MANIFEST).is_file():
            return candidate
    return folder.parent if folder.name in _PARTS else folder


def is_within(path: Path, folders: Iterable[Path]) -> bool:
    """Return whether a file is in one of the folders, following symbolic links."""
    place = path.resolve()
    return any(place.is_relative_to(folder.resolve()) for folder in folders)


def require_own(path: Path, folders: Iterable[Path], described: Path, place: str) -> None:
    """Refuse a file outside the folders, naming the description and the place that refers to it."""
    folders = list(folders)
    if not is_within(path, folders):
        listed = ", ".join(map(str, folders))
        raise DescriptionError(
            described,
            place,
            f"is {path.resolve()}, expected a file in {listed}, or in a folder given by --package-path",
        )
