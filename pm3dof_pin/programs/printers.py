"""The languages that programs are printed in. A further one is a file with such a function, and a line here.

Tests of its own run random programs, and the walks of all robots, in each of them: see `tests/programs`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.javascript import javascript

PRINTERS: Mapping[str, Callable[..., str]] = {"c": c99, "js": javascript}
"""Function of a program or walk, and optionally `parameters`, that prints source code, by the suffix of its files."""
