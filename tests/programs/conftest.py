"""Running printed programs: C by a compiler, JavaScript by Node; tests that need them skip where they are absent."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC")


@pytest.fixture
def compiled_c(tmp_path: Path) -> Callable[[str], ctypes.CDLL]:
    """Compile C99 without any warning, and load it."""
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")

    def load(source: str) -> ctypes.CDLL:
        path, library = tmp_path / "programs.c", tmp_path / "programs.so"
        path.write_text(source, encoding="utf-8")
        subprocess.run([compiler, *STRICT, path, "-o", library, "-lm"], check=True, timeout=100)
        return ctypes.CDLL(str(library))

    return load


@pytest.fixture
def run_javascript() -> Callable[[str, str], Any]:
    """Evaluate a JavaScript expression, whose numbers become texts, after a source."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node")

    def run(source: str, expression: str) -> Any:
        as_text = '(_, value) => typeof value === "number" ? String(value) : value'
        script = f"{source}\nconsole.log(JSON.stringify({expression}, {as_text}));"
        answer = subprocess.run([node, "-"], input=script, capture_output=True, text=True, check=True, timeout=100)
        return json.loads(answer.stdout)

    return run
