"""Which blocks of an atlas are finished: a journal with a checksum of every file of every block.

Lines are appended and brought to the disk after the blocks they are about. Each begins with its own checksum; a line
that is torn or damaged is as good as none, and its blocks are computed again.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

Block: TypeAlias = tuple[int, ...]
"""First index of a block along each dimension."""

Checksums: TypeAlias = Mapping[str, int | None]
"""CRC-32 of a block's file in each array, by the array's name; None where no file is, as all is the fill value."""


@dataclass(frozen=True)
class Journal:
    """The journal of one atlas; its first line is the specification that tells atlases apart."""

    path: Path
    specification: str

    def belongs(self) -> bool | None:
        """Tell whether the journal is of this atlas; None if there is none or its first line cannot be read."""
        first = next(iter(self._lines()), None)
        return None if first is None else first == self.specification

    def read(self) -> dict[Block, Checksums]:
        """Return the finished blocks and their checksums; none if the journal is of another atlas."""
        found: dict[Block, Checksums] = {}
        lines = self._lines()
        if not lines or lines[0] != self.specification:
            return found
        for entries in lines[1:]:
            if isinstance(entries, list):
                found |= {tuple(block): checksums for block, checksums in entries}
        return found

    def write(self, blocks: Mapping[Block, Checksums]) -> None:
        """Write the whole journal anew."""
        fresh = self.path.with_name(self.path.name + ".new")
        fresh.write_text(_line(self.specification) + (_line(list(blocks.items())) if blocks else ""))
        sync(fresh)
        fresh.replace(self.path)
        sync(self.path.parent)

    def append(self, blocks: Sequence[tuple[Block, Checksums]]) -> None:
        """Add finished blocks."""
        with self.path.open("a") as file:
            file.write(_line(list(blocks)))
            file.flush()
            os.fsync(file.fileno())

    @property
    def damaged(self) -> bool:
        """Whether it is missing, or a line of it cannot be believed."""
        return not self.path.is_file() or len(self._lines()) < len(self.path.read_bytes().splitlines())

    def _lines(self) -> list[Any]:
        """Return what the sound lines say."""
        try:
            lines = self.path.read_bytes().splitlines()
        except OSError:
            return []
        return [json.loads(line[9:]) for line in lines if line[:9] == b"%08x " % zlib.crc32(line[9:])]


def sync(path: Path) -> None:
    """Bring a file, or the names in a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _line(content: Any) -> str:
    text = json.dumps(content)
    return f"{zlib.crc32(text.encode()):08x} {text}\n"
