"""Disk cache of traced and compiled programs, so that only the first use of a robot traces and compiles.

The folder is ``PM3DOF_CACHE_DIR`` if that is set (if it is empty, nothing is cached), otherwise ``pm3dof-pin`` in the
user's cache folder. It is private to its user, and not used if anyone else owns it or can write to it, since code is
loaded from it. Damaged entries are rebuilt; if the folder is not writable, everything is rebuilt each time.
"""

from __future__ import annotations

import gc
import hashlib
import logging
import os
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import pm3dof_pin
from pm3dof_pin.exceptions import InvalidValueError, OutputError, ProgramError
from pm3dof_pin.files import write_atomically
from pm3dof_pin.programs.making import making
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import Walk

if TYPE_CHECKING:
    from pm3dof_pin.programs import llvm  # where it runs, LLVM is loaded by what compiles: a tenth of a short command

LARGEST = 200 * 2**20
"""Size limit in bytes, exceeded by up to a twentieth before the least recently used entries are removed."""

MOST_OPERATIONS = 250_000
"""Longer programs are not compiled, which would take half a minute: the reference computes what they would."""

_unmeasured = LARGEST  # bytes written since the folder was last measured

_SUFFIX = ".program"
_DIGEST = hashlib.sha256().digest_size
_LOG = logging.getLogger(__name__)


_known: dict[str, llvm.Compiled | ProgramError] = {}


def known(key: str, make: Callable[[], Program]) -> llvm.Compiled:
    """Return the program of a :func:`stored` key: from memory, from disk, or made now, and compiled once it is run.

    Failures are cached too.

    Raises:
        ProgramError: `make` raises it, or the program is too long.
    """
    if key not in _known:
        try:
            _known[key] = compiled(stored(key, make), when_run=True)
        except ProgramError as error:
            _known[key] = error
    found = _known[key]
    if isinstance(found, ProgramError):
        raise found
    return found


def stored(key: str, make: Callable[[], Program]) -> Program:
    """Return the cached program of a key, or make and cache it; the key excludes only the package's sources."""
    name = _name("traced", key)
    if (found := _recorded(name)) is not None:
        return found
    with making("recording a program"), _without_collection():
        program = make()
    # of processes that record it at once, from variants of a machine, the first decides: programs differ by rounding
    if (found := _recorded(name)) is not None:
        return found
    _keep(name, program.content)
    return program


def _recorded(name: str) -> Program | None:
    content = _read(name)
    if content is not None:
        try:
            return Program.from_bytes(content)
        except InvalidValueError:
            _LOG.info("cache entry %s is not a program; rebuilt", name)
    return None


@contextmanager
def _without_collection() -> Iterator[None]:
    """Keep Python from looking for garbage among the numbers being recorded, a third of the time of a long program."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def compiled(program: Program | Walk, *, when_run: bool = False) -> llvm.Compiled:
    """Return the program as machine code, cached or compiled now; or else compiled `when_run`.

    It is first compiled quickly, and with full optimisation once it has run for enough poses.

    Raises:
        ProgramError: it has more than :data:`MOST_OPERATIONS`, or LLVM does not compile it.
    """
    from pm3dof_pin.programs import llvm

    require_short(_step(program))
    with_care = partial(_code, program, optimized=True)
    for optimized in (True, False):
        name = _code_name(program, optimized=optimized)
        code = _read(name)
        if code is not None:
            try:
                return llvm.Compiled(program, code, faster=None if optimized else with_care)
            except ProgramError:
                _LOG.info("cache entry %s cannot be loaded; recompiled", name)
    quickly = partial(_made, program, optimized=False)
    return llvm.Compiled(program, quickly if when_run else quickly(), faster=with_care)


def require_short(program: Program) -> None:
    """Raise ProgramError for a program of more than :data:`MOST_OPERATIONS`."""
    if (count := len(program.codes)) > MOST_OPERATIONS:
        name = program.name
        raise ProgramError(f"program '{name}' has {count:,} operations, more than the {MOST_OPERATIONS:,} compiled")


def _step(program: Program | Walk) -> Program:
    return program.step if isinstance(program, Walk) else program


def _code(program: Program | Walk, *, optimized: bool) -> bytes:
    return _read(_code_name(program, optimized=optimized)) or _made(program, optimized=optimized)


def _made(program: Program | Walk, *, optimized: bool) -> bytes:
    from pm3dof_pin.programs import llvm

    with making(f"compiling {len(_step(program).codes):,} operations"):
        code = llvm.object_code(program, llvm.target().lanes, optimized)
    _keep(_code_name(program, optimized=optimized), code)
    return code


def _code_name(program: Program | Walk, *, optimized: bool) -> str:
    from pm3dof_pin.programs import llvm

    processor = llvm.target()
    key = program.key, *llvm.versions(), processor.name, processor.features, str(processor.lanes), str(optimized)
    return _name("compiled", *key)


def _folder() -> Path | None:
    """Return the cache folder, created if missing; None if it is unavailable."""
    path = _wanted_folder()
    if path is None:
        return None
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = path.stat()
    except OSError as error:
        _LOG.info("compiled programs are not cached: %s: %s", path, error.strerror)
        return None
    if status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        _LOG.warning("compiled programs are not cached: %s is writable by others", path)
        return None
    return path


def _wanted_folder() -> Path | None:
    named = os.environ.get("PM3DOF_CACHE_DIR")
    if named is not None:
        return Path(named) if named else None
    shared = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(shared):
        return Path(shared) / "pm3dof-pin"
    try:
        home = Path.home()
    except RuntimeError:
        return None
    return home / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "pm3dof-pin"


def _name(kind: str, *key: str) -> str:
    """Return the name of an entry; it depends on the versions of everything that makes it."""
    made_by = "programs" if kind == "compiled" else ""
    digest = hashlib.sha256("\0".join((_sources(made_by), *key)).encode()).hexdigest()
    return f"{kind}-{digest[:40]}{_SUFFIX}"


@cache
def _sources(room: str) -> str:
    """Return the version of this package, and sizes and times of the sources of a subpackage, or ("") of all."""
    root = os.path.join(os.path.dirname(pm3dof_pin.__file__), room)
    return "\n".join([pm3dof_pin.__version__, *sorted(_source_files(root))])


def _source_files(directory: str) -> Iterator[str]:
    with os.scandir(directory) as entries:
        for entry in entries:
            if entry.name.endswith(".py"):
                status = entry.stat()
                yield f"{entry.path} {status.st_size} {status.st_mtime_ns}"
            elif entry.is_dir() and not entry.name.startswith(("_", ".")):
                yield from _source_files(entry.path)


def _read(name: str) -> bytes | None:
    """Return an entry, or None if it is missing or damaged."""
    place = _folder()
    if place is None:
        return None
    path = place / name
    try:
        entry = path.read_bytes()
        os.utime(path)
    except OSError:
        return None
    content = entry[_DIGEST:]
    if hashlib.sha256(content).digest() != entry[:_DIGEST]:
        _LOG.info("%s is damaged; rebuilt", path)
        return None
    return content


def _keep(name: str, content: bytes) -> None:
    """Write an entry if possible, and make room once much has been written."""
    global _unmeasured
    place = _folder()
    if place is None:
        return
    try:
        with write_atomically(place / name) as temporary:
            temporary.write_bytes(hashlib.sha256(content).digest() + content)
        _unmeasured += len(content)
        if _unmeasured > LARGEST / 20:
            _make_room(place, name)
            _unmeasured = 0
    except (OutputError, OSError) as error:
        _LOG.info("compiled programs are not cached: %s", error)


def _make_room(place: Path, newest: str) -> None:
    entries = []
    with os.scandir(place) as found:
        for entry in found:
            if entry.name.endswith(_SUFFIX):
                with suppress(FileNotFoundError):  # another process makes room too
                    entries.append((entry, entry.stat()))
    entries.sort(key=lambda entry: (entry[0].name == newest, entry[1].st_mtime_ns), reverse=True)
    total = 0
    for entry, status in entries:
        total += status.st_size
        if total > LARGEST:
            Path(entry.path).unlink(missing_ok=True)
