"""Journal of the finished blocks of an atlas, with a checksum of every file of every block.

Lines are appended and synced to disk after the blocks they describe. Each begins with its own checksum; a torn or
damaged line is ignored, and its blocks are computed again.
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
"""CRC-32 of a block's file in each array, by the array's name; None without a file, if all is the fill value."""


@dataclass(frozen=True)
class Journal:
    """The journal of one atlas; its first line is the specification that identifies the atlas."""

    path: Path
    specification: str

    def belongs(self) -> bool | None:
        """Tell whether the journal belongs to this atlas; None without a journal or with an unreadable first line."""
        first = next(iter(self._lines()), None)
        return None if first is None else first == self.specification

    def read(self) -> dict[Block, Checksums]:
        """Return the finished blocks and their checksums; none if the journal belongs to another atlas."""
        found: dict[Block, Checksums] = {}
        lines = self._lines()
        if not lines or lines[0] != self.specification:
            return found
        for entries in lines[1:]:
            if isinstance(entries, list):
                found |= {tuple(block): checksums for block, checksums in entries}
        return found

    def write(self, blocks: Mapping[Block, Checksums]) -> None:
        """Rewrite the whole journal."""
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
        """Whether the journal is missing, or has an invalid line."""
        return not self.path.is_file() or len(self._lines()) < len(self.path.read_bytes().splitlines())

    def _lines(self) -> list[Any]:
        """Return the contents of the valid lines."""
        try:
            lines = self.path.read_bytes().splitlines()
        except OSError:
            return []
        return [json.loads(line[9:]) for line in lines if line[:9] == b"%08x " % zlib.crc32(line[9:])]


def sync(path: Path) -> None:
    """Sync a file, or the names in a folder, to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _line(content: Any) -> str:
    text = json.dumps(content)
    return f"{zlib.crc32(text.encode()):08x} {text}\n"
