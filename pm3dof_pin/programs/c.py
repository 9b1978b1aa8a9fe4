"""Programs printed as C99 for controllers; only `math.h` is needed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.programs.program import Program

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
"""C expression of each operation, by operands."""

_CONDITIONS = frozenset(("less", "and", "or", "not"))


def c99(
    program: Program,
    *,
    summary: str,
    descriptions: Mapping[str, str] | None = None,
    parameters: ArrayLike | None = None,
) -> str:
    """Print a program as one C function without loops, allocation or state, and a table of parameters if given.

    ``void name(const double *x, const double *p, double *y)`` has inputs x, parameters p and outputs y; y may alias x.
    ``name_parameters`` holds the parameter values. The comment has a summary and descriptions by name, with units.

    Raises:
        InvalidValueError: the number of values is not the number of parameters.
    """
    texts = descriptions or {}
    parts = ["#include <math.h>", ""]
    if parameters is not None:
        parts += _table(program, np.asarray(parameters, dtype=float))
    parts += ["/*", *(f" * {line}".rstrip() for line in _comment(program, summary, texts)), " */"]
    parts += [f"void {program.name}(const double *x, const double *p, double *y)", "{"]
    names = [f"x[{k}]" for k in range(len(program.inputs))]
    names += [f"p[{k}]" for k in range(len(program.parameters))]
    names += map(literal, program.constants)
    used = {number for _, operands in program.lines for number in operands} | set(program.results)
    first_parameter, first_constant = len(program.inputs), program.first_line - len(program.constants)
    for argument, numbers in (("x", range(first_parameter)), ("p", range(first_parameter, first_constant))):
        if used.isdisjoint(numbers):
            parts.append(f"  (void){argument};")
    for number, (operation, operands) in enumerate(program.lines, len(names)):
        kind = "int" if operation in _CONDITIONS else "double"
        expression = EXPRESSIONS[operation].format(*(names[k] for k in operands))
        parts.append(f"  const {kind} v{number} = {expression};")
        names.append(f"v{number}")
    results = [names[number] for number in program.results]
    for k, (name, number) in enumerate(zip(results, program.results, strict=True)):
        if number < len(program.inputs):  # y may alias x, so everything is read before anything is written
            parts.append(f"  const double r{k} = {name};")
            results[k] = f"r{k}"
    parts += [f"  y[{k}] = {name};" for k, name in enumerate(results)]
    return "\n".join([*parts, "}", ""])


def _comment(program: Program, summary: str, descriptions: Mapping[str, str]) -> Iterable[str]:
    """Yield the lines that describe the function's arguments."""
    yield _harmless(summary)
    for title, array, names in (
        ("inputs", "x", program.inputs),
        ("parameters, the same for all poses", "p", program.parameters),
    ):
        yield ""
        yield f"{array}[{len(names)}], {title}:"
        yield from (f"  {array}[{k}]  {_described(name, descriptions)}" for k, name in enumerate(names))
    yield ""
    yield f"y[{len(program.results)}], outputs:"
    for group, shape in program.outputs.items():
        place = program.slices[group]
        last = f" .. y[{place.stop - 1}]" if place.stop - place.start > 1 else ""
        size = f"  ({' x '.join(map(str, shape))}, row by row)" if len(shape) > 1 else ""
        yield f"  y[{place.start}]{last}  {_described(group, descriptions)}{size}"


def _described(name: str, descriptions: Mapping[str, str]) -> str:
    return _harmless(f"{name}: {descriptions[name]}" if name in descriptions else name)


def _harmless(text: str) -> str:
    """Return text that does not end the comment it is put in."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\n", "\n * ")


def _table(program: Program, values: np.ndarray) -> list[str]:
    if values.shape != (len(program.parameters),):
        expected = f"{len(program.parameters)} values, as {program.name} has parameters"
        raise ShapeError("parameters", values.shape, expected)
    if not len(values):
        return []
    rows = (
        f"  {literal(value)}, /* {_harmless(name)} */"
        for name, value in zip(program.parameters, values.tolist(), strict=True)
    )
    return [f"const double {program.name}_parameters[{len(values)}] = {{", *rows, "};", ""]


def literal(value: float, nan: str = "NAN", infinity: str = "INFINITY") -> str:
    """Format a number with all digits, parenthesised where a preceding sign would form another operator."""
    if math.isnan(value):
        return nan
    text = infinity if math.isinf(value) else repr(abs(value))
    return f"(-{text})" if math.copysign(1.0, value) < 0.0 else text
