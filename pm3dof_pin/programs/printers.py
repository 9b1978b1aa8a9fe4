"""The languages that programs are printed in. A further one is a file with such a function, and a line here.

`tests/programs` runs random programs, and the walks of all robots, in each of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.javascript import javascript
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import Walk

PRINTERS: Mapping[str, Callable[[Program | Walk], str]] = {"c": c99, "js": javascript}
"""Function that prints a program or a walk as source code, by the suffix of its files."""
