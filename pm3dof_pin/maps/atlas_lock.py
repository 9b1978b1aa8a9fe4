"""One run at a time on one atlas."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pm3dof_pin.exceptions import OutputError

_log = logging.getLogger(__name__)


@contextmanager
def exclusive_run(path: Path) -> Iterator[None]:
    """Hold the lock of an atlas; it ends with the process, in whatever way.

    The lock is the operating system's, on the file `.<name>.lock` next to the atlas, which says who holds it. A file
    without a holder was left by a killed run, and is taken over.

    Raises:
        OutputError: another run holds the lock, or the folder cannot be written.
    """
    place = path.with_name(f".{path.name}.lock")
    made = [folder for folder in place.absolute().parents if not folder.exists()]
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _acquire(place)
    except BlockingIOError as error:
        raise OutputError(path, f"another run, {_holder(place)}, is computing it; wait until it has ended") from error
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error
    try:
        yield
    finally:
        place.unlink(missing_ok=True)
        os.close(descriptor)
        with suppress(OSError):  # leave no empty folder
            for folder in made:
                folder.rmdir()


def _acquire(place: Path) -> int:
    """Lock the file, write its holder into it and return its descriptor; BlockingIOError if another process has it."""
    while True:
        descriptor = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if place.exists() and os.fstat(descriptor).st_ino == place.stat().st_ino:
                break
        except OSError:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the previous holder has just removed the file
    if os.fstat(descriptor).st_size:
        _log.warning("%s was left by a run that was killed, %s", place.name, _holder(place))
    os.ftruncate(descriptor, 0)
    holder = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.strftime("%Y-%m-%d %H:%M:%S")}
    os.write(descriptor, json.dumps(holder).encode())
    return descriptor


def _holder(place: Path) -> str:
    try:
        holder = json.loads(place.read_bytes())
        return f"pid {holder['pid']} on {holder['host']}, since {holder['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "of an unknown process"
