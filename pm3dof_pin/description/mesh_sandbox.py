"""Reads mesh files in a process of its own; run as a script, never imported by the package.

Readers of mesh formats are large, and files may be damaged or hostile. Here the operating system limits memory, and an
audit hook of the interpreter refuses to open files outside the mesh's folder, to write, to start processes, and to
connect anywhere. Requests are lines with a path on standard input. An answer is a line of JSON, with an error or the
numbers of vertices and triangles and the colour of each mesh, followed by the vertices (float64) and triangles (int64).
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from typing import Any

_BYTES = 2 << 30
_MAX_TRIANGLES = 10_000_000
_FORBIDDEN_EVENTS = (
    "subprocess.",
    "socket.",
    "os.exec",
    "os.spawn",
    "os.posix_spawn",
    "os.fork",
    "os.system",
    "os.kill",
)


def _limit() -> None:
    try:
        import resource
    except ImportError:  # not on this operating system
        return
    for kind, most in (("AS", _BYTES), ("CORE", 0), ("FSIZE", 0)):
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(getattr(resource, f"RLIMIT_{kind}"), (most, most))


def _watch(folder: list[str]) -> None:
    """From now on, permit only reading the interpreter's files and those in the one folder that the list contains."""
    own = [os.path.realpath(path) for path in {sys.prefix, sys.base_prefix, *sys.path} if path]
    own += ["/proc/self", "/usr/share/mime", "/dev/null", "/dev/urandom"]

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            name, mode = arguments[0], arguments[1] or "r"
            path = os.path.realpath(os.fsdecode(name)) if isinstance(name, (str, bytes)) else ""
            if path and (set(str(mode)) & set("wax+") or not _is_within(path, [*own, *folder])):
                raise PermissionError(f"it refers to {path}, which is not in {', '.join(folder)}")
        elif event.startswith(_FORBIDDEN_EVENTS):
            raise PermissionError(f"it asks for {event}")

    sys.addaudithook(hook)


def _is_within(path: str, folders: list[str]) -> bool:
    return any(path == folder or path.startswith(folder.rstrip(os.sep) + os.sep) for folder in folders)


def _read(path: str) -> tuple[dict[str, Any], list[bytes]]:
    import numpy as np
    import trimesh

    meshes = [mesh for mesh in trimesh.load_scene(path).dump() if isinstance(mesh, trimesh.Trimesh)]
    sizes = [[len(mesh.vertices), len(mesh.faces)] for mesh in meshes]
    if sum(size[1] for size in sizes) > _MAX_TRIANGLES:
        return {"error": f"has more than {_MAX_TRIANGLES} triangles"}, []
    blocks = []
    for mesh in meshes:
        corners = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        if any(array.shape[1:] != (3,) for array in corners):
            return {"error": "its vertices and faces are not triples of numbers"}, []
        if not (np.isfinite(corners[0]).all() and (corners[1] >= 0).all() and (corners[1] < len(corners[0])).all()):
            return {"error": "a vertex is not finite, or a face has vertices that do not exist"}, []
        blocks += [np.asarray(mesh.vertices, dtype="<f8").tobytes(), np.asarray(mesh.faces, dtype="<i8").tobytes()]
    return {"sizes": sizes, "colours": [_colour(mesh) for mesh in meshes]}, blocks


def _colour(mesh: Any) -> list[float] | None:
    """Return the main colour of a mesh's material, red, green, blue, opacity from 0 to 1."""
    if mesh.visual.kind is None:
        return None
    painted = mesh.visual.material if mesh.visual.kind == "texture" else mesh.visual
    return [float(part) / 255.0 for part in painted.main_color]


def _main() -> None:
    import trimesh  # noqa: F401  before memory is limited

    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # readers may print
    folder: list[str] = []
    _limit()
    _watch(folder)
    for line in sys.stdin:
        path = json.loads(line)
        folder[:] = [os.path.dirname(os.path.realpath(path))]
        blocks: list[bytes] = []
        try:
            answer, blocks = _read(path)
        except MemoryError:
            answer = {"error": f"takes more than {_BYTES >> 30} GiB of memory"}
        except Exception as error:  # readers may raise anything
            answer = {"error": " ".join(str(error).split())[:300] or type(error).__name__}
        answers.write((json.dumps(answer) + "\n").encode())
        for block in blocks:
            answers.write(block)
        answers.flush()


if __name__ == "__main__":
    _main()
