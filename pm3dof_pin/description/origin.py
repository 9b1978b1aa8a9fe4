"""Where a statement of a description stands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pm3dof_pin.exceptions import DescriptionError


@dataclass(frozen=True)
class Origin:
    """Where a statement stands: its file and line."""

    path: Path | str = ""  #: the file, or a name
    line: int | None = None  #: the line, from 1

    def __str__(self) -> str:
        return str(self.path) if self.line is None else f"{self.path}, line {self.line}"

    def error(self, element: str, expected: str) -> DescriptionError:
        """Return the error that an element here is not as expected."""
        return DescriptionError(self.path, element, expected, self.line)


NOWHERE = Origin()
"""The origin of what was not read from a file."""
