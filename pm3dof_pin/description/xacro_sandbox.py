"""Expands a xacro file in a sandboxed process; run as a script, never imported by the package.

A xacro file is a program: its expressions are Python. Three layers protect the machine:

- expressions are checked before evaluation: no names or attributes that reach the interpreter;
- an audit hook of the interpreter refuses to open files outside the given folders, to write, to start processes, to
  connect anywhere, and to load native code;
- the operating system limits memory and time, and the environment is empty.

The request is a JSON object on standard input, the answer one on standard output.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import io
import json
import os
import re
import sys
from typing import Any

_SECONDS = 10
_BYTES = 2 << 30
_INTERPRETER = frozenset({
    "mro", "format", "format_map", "gi_frame", "gi_code", "gi_yieldfrom", "ag_frame", "ag_code", "cr_frame", "cr_code",
    "cr_origin", "tb_frame", "tb_next", "f_back", "f_builtins", "f_code", "f_globals", "f_locals", "f_trace",
    "co_consts", "co_names", "func_globals", "func_code",
})  # fmt: skip
"""Attributes that reach the interpreter, in addition to those that begin with an underscore."""

_NOT_OFFERED = ("type", "vars")
_FORBIDDEN_EVENTS = (
    "subprocess.", "socket.", "ctypes.", "os.exec", "os.spawn", "os.posix_spawn", "os.fork", "os.forkpty", "os.system",
    "os.startfile", "os.kill", "os.killpg", "os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink",
    "os.chmod", "os.chown", "os.truncate", "os.utime", "os.putenv", "os.chdir", "shutil.", "tempfile.", "urllib.",
    "http.", "ftplib.", "smtplib.", "pty.", "mmap.", "fcntl.", "resource.", "signal.", "sys.settrace", "sys.setprofile",
    "sys._getframe", "code.__new__", "gc.", "pickle.find_class", "marshal.", "webbrowser.", "sqlite3.", "winreg.",
)  # fmt: skip


class _RefusedError(Exception):
    """The file attempts something forbidden."""


class _Arguments(dict[str, str]):
    """Values of arguments, which record the names that the file declares or reads."""

    def __init__(self, values: dict[str, str], known: set[str]) -> None:
        super().__init__(values)
        self._known = known

    def __contains__(self, name: object) -> bool:
        self._known.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self._known.add(name)
        return super().__getitem__(name)


@functools.cache
def _checked(expression: str) -> Any:
    """Return the compiled expression if it contains nothing forbidden."""
    tree = ast.parse(expression.strip(), "<expression>", mode="eval")
    for node in ast.walk(tree):
        name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
        hidden = name.startswith("_") if isinstance(node, ast.Attribute) else name.startswith("__")
        if hidden or (isinstance(node, ast.Attribute) and name in _INTERPRETER):
            raise _RefusedError(f"'{name}' in '{expression.strip()[:80]}' is not allowed")
    return compile(tree, "<expression>", "eval")


def _close(xacro: Any, substitution: Any, folders: list[str]) -> None:
    """Check every expression before evaluation, and restrict package look-ups."""

    def checked_eval(expression: str, symbols: Any, local: Any = None) -> Any:
        symbols.update(__builtins__={})
        return eval(_checked(expression), symbols, local)

    evaluate = substitution._eval

    def checked_substitution(expression: str, context: Any) -> Any:
        _checked(expression)
        return evaluate(expression, context)

    def find(package: str) -> str:
        candidates = [os.path.join(folder, package) for folder in folders]
        candidates += [folder for folder in folders if package in (os.path.basename(folder), _package_name(folder))]
        for candidate in candidates:
            if os.path.isdir(candidate) and _is_within(candidate, folders):
                return candidate
        raise _RefusedError(f"no package '{package}' in {', '.join(folders)} (--package-path adds a folder)")

    xacro.safe_eval = checked_eval
    substitution._eval = checked_substitution
    substitution._eval_find = substitution._eval_dict["find"] = find
    for name in _NOT_OFFERED:
        dict.pop(xacro._global_symbols["python"], name, None)


def _package_name(folder: str) -> str:
    """Return the name that a folder's package.xml gives it, which need not be the folder's own."""
    try:
        with open(os.path.join(folder, "package.xml"), encoding="utf-8", errors="replace") as file:
            found = re.search(r"<name>\s*([^<\s]+)\s*</name>", file.read(1 << 16))
    except OSError:
        return ""
    return found[1] if found else ""


def _is_within(path: str, folders: list[str]) -> bool:
    path = os.path.realpath(path)
    return any(path == folder or path.startswith(folder.rstrip(os.sep) + os.sep) for folder in folders)


def _watch(folders: list[str], files: list[str]) -> None:
    """From now on, permit only reading these files and those in these folders."""

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            name, mode = arguments[0], arguments[1] or "r"
            path = os.fsdecode(name) if isinstance(name, (str, bytes)) else ""
            if not path or set(str(mode)) & set("wax+"):
                raise _RefusedError(f"it opens {name} to write")
            if not (_is_within(path, folders) or os.path.realpath(path) in files):
                allowed = ", ".join(folders)
                raise _RefusedError(f"it reads {path}, which is not in {allowed}")
            if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe would block
                raise _RefusedError(f"it reads {path}, which is not a regular file")
        elif event in ("os.listdir", "os.scandir", "glob.glob"):
            path = os.fsdecode(arguments[0] or ".") if not isinstance(arguments[0], int) else "."
            if event != "glob.glob" and not _is_within(path, folders):
                raise _RefusedError(f"it lists {path}, which is not in {', '.join(folders)}")
        elif event.startswith(_FORBIDDEN_EVENTS):
            raise _RefusedError(f"it asks for {event}")

    sys.addaudithook(hook)


def _limit() -> None:
    try:
        import resource
    except ImportError:  # not on this operating system
        return
    for kind, most in (("CPU", _SECONDS), ("AS", _BYTES), ("CORE", 0), ("FSIZE", 0)):
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(getattr(resource, f"RLIMIT_{kind}"), (most, most))


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    sys.path[:] = request["modules"]
    import glob  # noqa: F401  while imports are still possible
    import xml.dom.expatbuilder
    import xml.parsers.expat

    import xacro
    import yaml
    from xacro import substitution_args

    del xml
    yaml.SafeLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # type: ignore[misc]  # libyaml, if available
    folders = [os.path.realpath(folder) for folder in request["folders"]]
    _close(xacro, substitution_args, folders)
    _limit()
    _watch(folders, [os.path.realpath(file) for file in request["files"]])
    texts: list[str] = []
    known: set[str] = set()
    for path in request["paths"]:
        answer = _expanded(xacro, path, _Arguments(request["mappings"], known))
        if "text" not in answer:
            return {**answer, "texts": texts}
        texts.append(answer["text"])
    return {"texts": texts, "unknown": sorted(set(request["mappings"]) - known)}


def _expanded(xacro: Any, path: str, mappings: dict[str, str]) -> dict[str, str]:
    from xml.parsers.expat import ExpatError

    try:
        document = xacro.process_file(path, mappings=mappings)
        return {"text": document.documentElement.toxml()}
    except _RefusedError as error:
        return {"refused": str(error)}
    except xacro.XacroException as error:
        outer: Any = error  # xacro wraps an error once per enclosing expression
        while isinstance(outer.exc, xacro.XacroException):
            outer = outer.exc
        inner = outer.exc
        if isinstance(inner, MemoryError):
            return {"error": f"takes more than {_BYTES >> 30} GiB of memory"}
        if isinstance(inner, _RefusedError):
            return {"refused": str(inner)}
        return {"error": " ".join(str(outer).split())}
    except ExpatError as error:
        return {"error": f"expected XML, here and in the files it includes ({error})"}
    except MemoryError:
        return {"error": f"takes more than {_BYTES >> 30} GiB of memory"}
    except RecursionError:
        return {"error": "recurses without end"}
    except Exception as error:
        return {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"}


if __name__ == "__main__":
    _stdout = sys.stdout
    sys.stdout = io.StringIO()  # discard what the file prints
    _stdout.write(json.dumps(_answer(json.load(sys.stdin))))
    _stdout.flush()
    os._exit(0)
