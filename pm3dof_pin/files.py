"""Reading files of moderate size; writing files atomically, tables as CSV."""

from __future__ import annotations

import csv
import glob
import io
import os
import re
import shutil
import socket
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pm3dof_pin.exceptions import DescriptionError, OutputError

_FORMULA_STARTS = frozenset("=+-@\t\r")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|nan)")

MAX_BYTES = 64 * 2**20
"""Largest file that is read, but for those that are long by nature."""


def read_bytes(path: Path | str, max_bytes: int = MAX_BYTES) -> bytes:
    """Read a regular file of moderate size; DescriptionError for a pipe or device, which may never end."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise DescriptionError(path, "file", "expected a regular file, not a folder, pipe or device")
        with Path(path).open("rb") as file:
            content = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:  # a name with a null byte is a ValueError
        raise DescriptionError(path, "file", f"expected a readable file ({_reason(error)})") from error
    if len(content) > max_bytes:
        raise DescriptionError(path, "file", f"expected no more than {max_bytes >> 20} MiB")
    return content


def read_text(path: Path | str, max_bytes: int = MAX_BYTES) -> str:
    """Read a UTF-8 text file, with or without a byte order mark; raises as :func:`read_bytes`."""
    try:
        return read_bytes(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DescriptionError(path, "file", f"expected UTF-8 text (byte {error.start} is invalid)") from error


@contextmanager
def write_atomically(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path next to `path`; it replaces `path` when the block ends without an error.

    The temporary file keeps the suffix of `path`, for writers that depend on it. Missing parent folders are created.
    An interrupted or failed block leaves `path` unchanged.

    Raises:
        OutputError: the folder or file cannot be written.
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        prefix = _prefix(target.parent, target.stem)
        descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=prefix, suffix=target.suffix)
        os.close(descriptor)
    except OSError as error:
        raise OutputError(target, _reason(error)) from error
    temporary = Path(name)
    try:
        yield temporary
        _set_default_mode(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise OutputError(target, _reason(error)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text_atomically(path: Path | str, text: str) -> Path:
    """Write UTF-8 text atomically (see :func:`write_atomically`) and return the path."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(path)


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV; an empty cell for NaN.

    A word that a spreadsheet would take for a formula has an apostrophe before it, as :func:`without_apostrophe` reads.
    """
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([_csv_cell(cell) for cell in row] for row in rows)
    return text.getvalue()


def without_apostrophe(cell: str) -> str:
    """Return a cell as :func:`csv_text` was given it."""
    return cell[1:] if cell[:1] == "'" and cell[1:2] in _FORMULA_STARTS else cell


def _csv_cell(cell: object) -> object:
    if isinstance(cell, str) and cell[:1] in _FORMULA_STARTS and not _NUMBER.fullmatch(cell):
        return f"'{cell}"
    return "" if cell != cell else cell


@contextmanager
def replace_directory(path: Path | str, marker: str) -> Iterator[Path]:
    """Yield an empty folder next to `path`; it replaces `path` when the block ends without an error.

    An existing folder is replaced only if it is empty or contains the file `marker`, which marks an older version.

    Raises:
        OutputError: the folder cannot be written, or something else already has that path.
    """
    target = Path(path)
    if target.exists() and not (target / marker).is_file() and (not target.is_dir() or any(target.iterdir())):
        raise OutputError(target, f"the path is taken: expected nothing there, or a folder with the file {marker}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=_prefix(target.parent, target.name)) as scratch:
            fresh, old = Path(scratch) / "new", Path(scratch) / "old"
            fresh.mkdir()
            yield fresh
            if target.exists():
                os.replace(target, old)
            os.replace(fresh, target)
    except OSError as error:
        raise OutputError(target, _reason(error)) from error


def _prefix(folder: Path, name: str) -> str:
    """Return the prefix of this process's temporary files, after removing those of processes that were killed.

    The names contain host and process: another host may write to the same folder.
    """
    own = f".{name}-{re.sub(r'[^A-Za-z0-9]', '_', socket.gethostname())}"
    for path in folder.glob(f"{glob.escape(own)}-*"):
        number = path.name.removeprefix(f"{own}-").partition("-")[0]
        if number.isdigit() and not _is_running(int(number)):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
    return f"{own}-{os.getpid()}-"


def _is_running(process: int) -> bool:
    if process == os.getpid() or os.name != "posix":  # elsewhere signal 0 does more than test
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's process, or not a process id
        return True
    return True


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _set_default_mode(path: Path) -> None:
    """Give a file made by mkstemp (owner only) the permissions of an ordinary new file."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(0o666 & ~mask)
