"""Which files belong to a description: those of its package, and of packages that were named."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pm3dof_pin.exceptions import DescriptionError

MANIFEST = "package.xml"
"""File that a ROS package has."""

_PARTS = ("urdf", "xacro", "robots", "mjcf", "sdf", "xml", "srdf")
_MOST_LEVELS = 4  # above a file, up to where its package is searched


def package_of(path: Path) -> Path:
    """Return the folder that a description's own files are in.

    It is the nearest one above the file that has a package.xml; else the file's own, or the one above if that is called
    urdf, xacro, robots, mjcf, sdf, xml or srdf.
    """
    folder = path.resolve().parent
    for candidate in (folder, *list(folder.parents)[:_MOST_LEVELS]):
        if (candidate / MANIFEST).is_file():
            return candidate
    return folder.parent if folder.name in _PARTS else folder


def is_within(path: Path, folders: Iterable[Path]) -> bool:
    """Tell whether a file is in one of some folders, symbolic links followed."""
    place = path.resolve()
    return any(place.is_relative_to(folder.resolve()) for folder in folders)


def require_own(path: Path, folders: Iterable[Path], described: Path, place: str) -> None:
    """Refuse a file from outside some folders, naming the description and the place where it is named."""
    folders = list(folders)
    if not is_within(path, folders):
        listed = ", ".join(map(str, folders))
        raise DescriptionError(
            described,
            place,
            f"is {path.resolve()}, expected a file in {listed}, or of a folder named by --package-path",
        )
