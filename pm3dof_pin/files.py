"""Writing files whole or not at all."""

from __future__ import annotations

import glob
import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pm3dof_pin.exceptions import OutputError


@contextmanager
def write_atomically(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on leaving the block without an error it takes the place of `path`.

    The temporary file keeps the suffix of `path`, so that writers which look at it work. An interrupted or failed block
    leaves `path` as it was.

    Args:
        path: file to write; missing parent folders are made.

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
        raise OutputError(target, error.strerror or str(error)) from error
    temporary = Path(name)
    try:
        yield temporary
        _set_default_mode(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise OutputError(target, error.strerror or str(error)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text_atomically(path: Path | str, text: str) -> Path:
    """Write UTF-8 text whole or not at all.

    Args:
        path: file to write.
        text: its contents.

    Returns:
        The path written.

    Raises:
        OutputError: the folder or file cannot be written.
    """
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(path)


@contextmanager
def replace_directory(path: Path | str, marker: str) -> Iterator[Path]:
    """Yield an empty folder beside `path`; on leaving the block without an error it takes the place of `path`.

    Args:
        path: folder to write; missing parent folders are made. A folder that is there already gives way only if it is
            empty or holds the file `marker`: if it is an older one of its kind.
        marker: name of a file that tells the kind.

    Raises:
        OutputError: the folder cannot be written, or something else is in its place.
    """
    target = Path(path)
    if target.exists() and not (target / marker).is_file() and (not target.is_dir() or any(target.iterdir())):
        raise OutputError(target, f"something else is there: expected nothing, or a folder with the file {marker}")
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
        raise OutputError(target, error.strerror or str(error)) from error


def _prefix(folder: Path, name: str) -> str:
    """Return how names of this process's temporary files begin, having removed those of processes that were killed.

    The names hold computer and process: another computer may write to the same folder.
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
    if process == os.getpid() or os.name != "posix":  # elsewhere signal 0 is no question
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # somebody else's, or no number of a process
        return True
    return True


def _set_default_mode(path: Path) -> None:
    """Give a file made by mkstemp (owner only) the permissions an ordinary new file has."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(0o666 & ~mask)
