"""urdfdom's messages while it reads a file, taken from its own logger.

urdfdom logs through console_bridge, whose output can go to a file. No stream of this process is redirected: other
threads write to the terminal as usual. If that library is not found, its messages go to the terminal.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pinocchio as pin

_one_reader = threading.Lock()
_NAMESPACE = "_ZN14console_bridge"
_HANDLER_BYTES = 256  # a vtable pointer and a FILE*, with room to spare


@contextmanager
def parser_messages() -> Iterator[list[str]]:
    """Collect urdfdom's messages during a block; the list is filled when the block ends."""
    lines: list[str] = []
    library = _console_bridge()
    if library is None:
        yield lines
        return
    with _one_reader, tempfile.TemporaryDirectory(prefix="pm3dof_") as folder:
        file = Path(folder) / "messages"
        handler = ctypes.create_string_buffer(_HANDLER_BYTES)
        library.construct(handler, os.fsencode(file))
        library.use(handler)
        try:
            yield lines
        finally:
            library.restore()
            library.destruct(handler)
            lines.extend(_messages(file.read_text(encoding="utf-8", errors="replace")))


class _Library:
    """console_bridge's functions, by their mangled names on Linux and macOS."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self.construct = self._function(library, "17OutputHandlerFileC1EPKc", ctypes.c_void_p, ctypes.c_char_p)
        self.destruct = self._function(library, "17OutputHandlerFileD1Ev", ctypes.c_void_p)
        self.use = self._function(library, "16useOutputHandlerEPNS_13OutputHandlerE", ctypes.c_void_p)
        self.restore = self._function(library, "28restorePreviousOutputHandlerEv")

    @staticmethod
    def _function(library: ctypes.CDLL, name: str, *arguments: Any) -> Any:
        function = library[_NAMESPACE + name]
        function.argtypes, function.restype = arguments, None
        return function


@cache
def _console_bridge() -> _Library | None:
    """Find the copy of the library that Pinocchio has loaded."""
    folder = Path(pin.__file__).resolve().parents[3]
    for path in sorted(folder.glob("libconsole_bridge.*")):
        try:
            return _Library(ctypes.CDLL(str(path), mode=os.RTLD_NOLOAD | os.RTLD_NOW))
        except (OSError, AttributeError):
            continue
    return None


def _messages(text: str) -> list[str]:
    """Return the messages without the lines that refer to urdfdom's sources."""
    lines = (line.strip() for line in text.splitlines())
    return [line for line in lines if line and not line.startswith("at line ")]
