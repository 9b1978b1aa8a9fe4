"""Mesh files (STL, OBJ, Collada, ...), read as triangle meshes."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.description.origin import Origin
from pm3dof_pin.description.own_files import MANIFEST, is_within, package_name, require_own
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.typing import Array

_KINDS = {".stl", ".obj", ".dae", ".ply", ".off", ".gltf", ".glb", ".3mf", ".3ds", ".wrl", ".msh", ".x3d", ".iv"}
_MAX_BYTES = 512 * 2**20
_MAX_SECONDS = 60.0  # to read one file
_SANDBOX = Path(__file__).with_name("mesh_sandbox.py")


def find_mesh(files: RobotFiles, name: str) -> Path:
    """Find a mesh by its name in a URDF: relative to the robot's folder, or `package://x/`.

    Only mesh files in the robot's own folders, in a package with a package.xml above it or in the package paths, and in
    the package paths themselves are accepted, all after following symbolic links.

    Raises:
        DescriptionError: the file is missing, is not a mesh, or lies outside the folders of the robot.
    """
    place, found = f"mesh '{name}'", [(path, own) for path, own in _candidates(files, name) if path.is_file()]
    if not found:
        raise DescriptionError(files.path, place, "expected an existing file")
    path, own = next(((path, own) for path, own in found if is_within(path, own)), found[0])
    require_own(path, own, Origin(files.path), place)
    path = path.resolve()
    if path.suffix.lower() not in _KINDS:
        raise DescriptionError(files.path, place, f"expected a file of type {', '.join(sorted(_KINDS))}")
    if path.stat().st_size > _MAX_BYTES:
        raise DescriptionError(files.path, place, f"expected no more than {_MAX_BYTES >> 20} MiB")
    return path


def _candidates(files: RobotFiles, name: str) -> Iterator[tuple[Path, Sequence[Path]]]:
    """Yield candidate paths of a mesh, each with the folders it must be in to be accepted."""
    folder = files.path.absolute().parent
    if not name.startswith("package://"):
        for start in (folder, *files.own_folders, *files.package_paths):
            yield start / name.removeprefix("file://"), files.own_folders
        return
    package, _, relative = name.removeprefix("package://").partition("/")
    is_name = package not in ("", ".", "..")
    for above in (*files.package_paths, *folder.parents):
        is_package = is_name and (above in files.own_folders or (above / package / MANIFEST).is_file())
        yield above / package / relative, [*files.own_folders, *([above / package] if is_package else [])]
    for above in (*files.package_paths, folder, *folder.parents):
        if is_name and package in (above.name, package_name(above)):
            is_package = (above / MANIFEST).is_file()
            yield above / relative, [*files.own_folders, *([above] if is_package else [])]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, placed as in its file."""

    vertices: Array  #: shape=(n, 3) [units of the file]
    faces: NDArray[np.int64]  #: three indices of vertices each, shape=(m, 3)
    colour: tuple[float, ...] | None  #: red, green, blue, opacity of its material, from 0 to 1, if it has one


def read_meshes(path: Path | str) -> list[Mesh]:
    """Read the meshes of a file, in a process of limited memory and time.

    Raises:
        DescriptionError: the file cannot be read, refers to files outside its folder, or takes too much memory or time.
    """
    return _reader.read(Path(path))


class _Reader:
    """The process that reads mesh files; started when needed, and again after a file that has ended it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""
        self._owner = 0
        atexit.register(self._stop)

    def read(self, path: Path) -> list[Mesh]:
        with self._lock:
            try:
                return self._answered(path)
            except (OSError, EOFError) as error:
                self._stop()
                reason = "it takes too much time" if isinstance(error, TimeoutError) else "reading it was aborted"
                raise DescriptionError(path, "mesh", f"expected a readable mesh ({reason})") from error
            except DescriptionError:
                raise
            except BaseException:
                self._stop()  # an answer half read
                raise

    def _answered(self, path: Path) -> list[Mesh]:
        if self._owner != os.getpid():  # after a fork, the process belongs to the parent
            self._process = None
        if self._process is None or self._process.poll() is not None:
            self._start()
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write((json.dumps(str(path.absolute())) + "\n").encode())
        self._process.stdin.flush()
        deadline = time.monotonic() + _MAX_SECONDS
        while b"\n" not in self._buffer:
            self._receive(deadline)
        line, _, self._buffer = self._buffer.partition(b"\n")
        answer = json.loads(line)
        if "error" in answer:
            problem = f"expected a readable mesh ({answer['error']})"
            raise DescriptionError(path, "mesh", problem)
        meshes = []
        for (vertices, faces), colour in zip(answer["sizes"], answer["colours"], strict=True):
            corners = np.frombuffer(self._bytes(24 * vertices, deadline), dtype="<f8").reshape(-1, 3)
            triangles = np.frombuffer(self._bytes(24 * faces, deadline), dtype="<i8").reshape(-1, 3)
            meshes.append(Mesh(corners, triangles, None if colour is None else tuple(colour)))
        return meshes

    def _bytes(self, count: int, deadline: float) -> bytes:
        parts = [self._buffer]
        size = len(self._buffer)
        while size < count:
            self._buffer = b""
            self._receive(deadline)
            parts.append(self._buffer)
            size += len(self._buffer)
        joined = b"".join(parts)
        self._buffer = joined[count:]
        return joined[:count]

    def _receive(self, deadline: float) -> None:
        assert self._process is not None
        assert self._process.stdout is not None
        stream = self._process.stdout.fileno()
        left = deadline - time.monotonic()
        if left <= 0.0 or not select.select([stream], [], [], left)[0]:
            raise TimeoutError
        if not (received := os.read(stream, 1 << 20)):
            raise EOFError
        self._buffer += received

    def _start(self) -> None:
        self._buffer, self._owner = b"", os.getpid()
        self._process = subprocess.Popen(
            [sys.executable, "-I", str(_SANDBOX)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # threads take address space
            start_new_session=True,  # Ctrl+C is ours to handle
        )

    def _stop(self) -> None:
        if self._process is not None and self._owner == os.getpid():
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    with contextlib.suppress(OSError):
                        stream.close()
            self._process = None


_reader = _Reader()
