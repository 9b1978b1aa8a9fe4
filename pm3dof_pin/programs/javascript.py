"""Programs printed as JavaScript, for self-contained pages."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.programs.c import EXPRESSIONS, literal
from pm3dof_pin.programs.program import Program

_EXPRESSIONS = EXPRESSIONS | {
    "sqrt": "Math.sqrt({0})",
    "sin": "Math.sin({0})",
    "cos": "Math.cos({0})",
    "atan2": "Math.atan2({0}, {1})",
    "absolute": "Math.abs({0})",
    "floor": "Math.floor({0})",
}


def javascript(program: Program, parameters: ArrayLike | None = None) -> str:
    """Print a program as one JavaScript function of arrays of double-precision numbers.

    `function name(x, y)` with built-in parameter values, or `function name(x, p, y)` without: inputs x,
    parameters p, outputs y.

    Raises:
        InvalidValueError: the number of values is not the number of parameters.
    """
    first = len(program.inputs)
    names = [f"x[{k}]" for k in range(first)]
    if parameters is None:
        names += [f"p[{k}]" for k in range(len(program.parameters))]
    else:
        values = np.asarray(parameters, dtype=float)
        if values.shape != (len(program.parameters),):
            expected = f"{len(program.parameters)} values, as {program.name} has parameters"
            raise ShapeError("parameters", values.shape, expected)
        names += map(_literal, values.tolist())
    names += map(_literal, program.constants)
    lines = []
    for number, (operation, operands) in enumerate(program.lines, len(names)):
        names.append(f"v{number}")
        lines.append(f"const v{number}={_EXPRESSIONS[operation].format(*(names[k] for k in operands))};")
    lines += [f"y[{k}]={names[number]};" for k, number in enumerate(program.results)]
    arguments = "x,y" if parameters is not None else "x,p,y"
    return "\n".join([f"function {program.name}({arguments}){{", '"use strict";', *lines, "}"])


def _literal(value: float) -> str:
    return literal(value, "NaN", "Infinity")
