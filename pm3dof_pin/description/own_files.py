"""Which files belong to a description: those of its package and of the packages given."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from pm3dof_pin.description.origin import Origin

MANIFEST = "package.xml"
"""The file that marks a ROS package."""

_PARTS = ("urdf", "xacro", "robots", "mjcf", "sdf", "xml", "srdf")
_PROJECT = (".git", "LICENSE", "LICENSE.txt", "LICENSE.md", "README.md", "README.rst")  # what a project's folder has
_MAX_MANIFEST = 1 << 16  # characters
_MAX_LEVELS = 4  # how far above a file its package is searched
_MAX_PROJECT_LEVELS = 8  # and its project


def package_of(path: Path) -> Path:
    """Return the folder of a description's own files.

    This is the nearest folder above the file with a package.xml; otherwise that of the project it is part of: the root
    of a git repository, or the nearest folder above with a licence or a readme. Neither is searched in the user's home
    folder, nor above it. Without any of these it is the file's own folder, or its parent if that is named urdf, xacro,
    robots, mjcf, sdf, xml or srdf.
    """
    folder = path.resolve().parent
    for candidate in (folder, *list(folder.parents)[:_MAX_LEVELS]):
        if (candidate / MANIFEST).is_file():
            return candidate
    own = folder.parent if folder.name in _PARTS else folder
    home = Path.home().resolve()
    above = [candidate for candidate in (own, *own.parents) if not home.is_relative_to(candidate)]
    for marks in (_PROJECT[:1], _PROJECT[1:]):
        for candidate in above[:_MAX_PROJECT_LEVELS]:
            if any((candidate / mark).exists() for mark in marks):
                return candidate
    return own


def package_name(folder: Path) -> str:
    """Return the name that a folder's package.xml gives it, which need not be the folder's own; "" without one."""
    try:
        with (folder / MANIFEST).open(encoding="utf-8", errors="replace") as file:
            text = file.read(_MAX_MANIFEST)
    except OSError:
        return ""
    found = re.search(r"<name>\s*([^<\s]+)\s*</name>", text)
    return found[1] if found else ""


def is_within(path: Path, folders: Iterable[Path]) -> bool:
    """Return whether a file is in one of the folders, following symbolic links."""
    place = path.resolve()
    return any(place.is_relative_to(folder.resolve()) for folder in folders)


def require_own(path: Path, folders: Iterable[Path], origin: Origin, place: str) -> None:
    """Refuse a file outside the folders, naming where and what refers to it."""
    folders = list(folders)
    if not is_within(path, folders):
        listed = ", ".join(map(str, folders))
        problem = f"is {path.resolve()}, expected a file in {listed}, or in a folder given by --package-path"
        raise origin.error(place, problem)
