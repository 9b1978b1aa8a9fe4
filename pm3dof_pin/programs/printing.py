"""What printers of programs as source code have in common: expressions, numbers, one assignment an operation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import Walk
from pm3dof_pin.typing import Vector

EXPRESSIONS = {
    "negative": "-{0}",
    "add": "{0} + {1}",
    "subtract": "{0} - {1}",
    "multiply": "{0} * {1}",
    "divide": "{0} / {1}",
    "sqrt": "sqrt({0})",
    "sin": "sin({0})",
    "cos": "cos({0})",
    "atan2": "atan2({0}, {1})",
    "absolute": "fabs({0})",
    "floor": "floor({0})",
    "minimum": "({0} < {1} || {0} != {0}) ? {0} : {1}",
    "maximum": "({1} < {0} || {0} != {0}) ? {0} : {1}",
    "less": "{0} < {1}",
    "and": "{0} && {1}",
    "or": "{0} || {1}",
    "not": "!{0}",
    "select": "{0} ? {1} : {2}",
}
"""Expression of each operation, by operands, in languages that descend from C."""

MAX_STEPS = 3000
"""Newton steps after which a walk in a page gives up; most take 10 to 100."""


def statements(
    program: Program,
    leaves: Sequence[str],
    declare: Callable[[str, str, str], str],
    expressions: Mapping[str, str] = EXPRESSIONS,
) -> list[str]:
    """Return one declaration for each operation, then the assignments of the outputs to an array y, which may be x.

    Args:
        program: the program.
        leaves: names of its inputs x, its parameters and constants.
        declare: returns the declaration of a value, given its operation, name and expression.
        expressions: expression of each operation, by operands.
    """
    lines, results = value_lines(program, leaves, declare, expressions)
    for k, number in enumerate(program.results):
        if number < len(program.inputs):  # everything is read before anything is written
            lines.append(declare("", f"r{k}", results[k]))
            results[k] = f"r{k}"
    return [*lines, *(f"y[{k}] = {name};" for k, name in enumerate(results))]


def value_lines(
    program: Program,
    leaves: Sequence[str],
    declare: Callable[[str, str, str], str],
    expressions: Mapping[str, str],
) -> tuple[list[str], list[str]]:
    """Return one declaration for each operation, and the names of the outputs; arguments as for `statements`."""
    names, lines = list(leaves), []
    for number, (operation, operands) in enumerate(program.lines, len(names)):
        names.append(f"v{number}")
        lines.append(declare(operation, names[-1], expressions[operation].format(*(names[k] for k in operands))))
    return lines, [names[number] for number in program.results]


def literal(value: float, nan: str, infinity: str) -> str:
    """Format a number with all digits, parenthesised where a preceding sign would form another operator."""
    if math.isnan(value):
        return nan
    text = infinity if math.isinf(value) else repr(abs(value))
    return f"(-{text})" if math.copysign(1.0, value) < 0.0 else text


def parameter_values(program: Program | Walk, parameters: ArrayLike) -> Vector:
    """Return values of a program's parameters as an array; ShapeError if there are fewer or more."""
    values = np.asarray(parameters, dtype=float)
    if values.shape != (len(program.parameters),):
        expected = f"{len(program.parameters)} values, as {program.name} has parameters"
        raise ShapeError("parameters", values.shape, expected)
    return values
