"""Programs printed as C99 for controllers; only `math.h` is needed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Literal, TypeAlias

from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.programs.printing import EXPRESSIONS, literal, parameter_values, statements
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import SHORTEST_LEG, Walk
from pm3dof_pin.typing import Vector

Real: TypeAlias = Literal["double", "float"]
"""Type of the numbers of printed functions."""

_CONDITIONS = frozenset(("less", "and", "or", "not"))
_SINGLE = EXPRESSIONS | {
    name: EXPRESSIONS[name].replace("(", "f(", 1) for name in ("sqrt", "sin", "cos", "atan2", "absolute", "floor")
}

_WALK = """{linkage}int {name}(const double *start, const double *targets, const double *p, int max_steps, double *q)
{{
  double x[{n_inputs}], block[{n_stepped} + {n_state}];
  double *const state = block + {n_stepped};
  double here, there;
  int k;
  for (k = 0; k < {nq}; k++)
    x[k] = start[k];
  for (k = 0; k < {m}; k++)
    x[{nq} + k] = targets[k];
  x[{nq} + {m}] = {shortest};
  x[{nq} + {m} + 1] = {tolerance};
  {name}_start(x, p, state);
  for (k = 0; k < max_steps && state[{status}] > 0.0; k++) {{
    {name}_step(state, p, block);
    {name}_control(block, p, state);
  }}
  if (state[{status}] > 0.0)
    return 4;
  if (state[{status}] < 0.0)
    return (int)-state[{status}];
  {branch}(start, p, &here);
  {branch}(state + {reached}, p, &there);
  if (here != there && state[{singular}] == 0.0)
    return 1;
  for (k = 0; k < {nq}; k++)
    q[k] = state[{reached} + k];
  return 0;
}}
"""


def c99(
    program: Program | Walk,
    *,
    summary: str = "",
    descriptions: Mapping[str, str] | None = None,
    parameters: ArrayLike | None = None,
) -> str:
    """Print a program as a C function without allocation or state, and a table of parameters if given.

    ``void name(const double *x, const double *p, double *y)`` has inputs x, parameters p and outputs y; y may alias x.
    A walk is ``int name(const double *start, const double *targets, const double *p, int max_steps, double *q)``. It
    returns 0 and writes q if it arrives, else minus its status, see :data:`~pm3dof_pin.programs.walk.REACHED`, or 4
    after `max_steps` Newton steps. ``name_parameters`` holds the parameter values. The comment has a summary and
    descriptions by name, with units.

    Raises:
        ShapeError: the number of values is not the number of parameters.
        InvalidValueError: the walk has no program that tells branches apart.
    """
    texts = descriptions or {}
    parts = ["#include <math.h>", ""]
    if parameters is not None:
        parts += _table(program, parameter_values(program, parameters))
    comment = ["/*", *(f" * {line}".rstrip() for line in _comment(program, summary, texts)), " */"]
    if isinstance(program, Program):
        return "\n".join([*parts, *comment, *function_lines(program, program.name), ""])
    return "\n".join([*parts, *comment, *walk_lines(program, program.name)])


def walk_lines(
    walk: Walk, name: str, *, linkage: str = "", branch: str | None = None, real: Real = "double"
) -> list[str]:
    """Return the functions of a walk, the last of which is `name`; `branch` names one that is printed elsewhere.

    Raises:
        InvalidValueError: the walk has no program that tells branches apart.
    """
    if walk.branch is None:
        raise InvalidValueError("program", expected="a walk with a branch")
    lines: list[str] = []
    for part, each in walk.parts.items():
        if part != "branch" or branch is None:
            lines += function_lines(each, f"{name}_{part}", linkage="static ", real=real)
    loop = _WALK.format(
        linkage=linkage,
        name=name,
        branch=branch or f"{name}_branch",
        nq=walk.nq,
        m=walk.n_targets,
        n_inputs=len(walk.start.inputs),
        n_stepped=len(walk.step.results),
        n_state=len(walk.start.results),
        shortest=number(SHORTEST_LEG, real),
        tolerance=number(walk.tolerance, real),
        status=walk.status,
        singular=walk.singular,
        reached=walk.reached.start,
    )
    return [*lines, in_type(loop, real)]


def in_type(text: str, real: Real) -> str:
    """Return C with numbers of type double in another type."""
    if real == "double":
        return text
    text = re.sub(r"\b(fabs|floor)\(", r"\1f(", re.sub(r"\b(\d+\.\d+)\b", r"\1f", text))
    return re.sub(r"\bdouble\b", real, text)


def function_lines(program: Program, name: str, *, linkage: str = "", real: Real = "double") -> list[str]:
    """Return the lines of a program's function, and an empty one."""
    lines = [f"{linkage}void {name}(const {real} *x, const {real} *p, {real} *y)", "{"]
    used = {number for _, operands in program.lines for number in operands} | set(program.results)
    first_parameter, first_constant = len(program.inputs), program.first_line - len(program.constants)
    for argument, numbers in (("x", range(first_parameter)), ("p", range(first_parameter, first_constant))):
        if used.isdisjoint(numbers):
            lines.append(f"  (void){argument};")
    leaves = [f"x[{k}]" for k in range(len(program.inputs))]
    leaves += [f"p[{k}]" for k in range(len(program.parameters))]
    leaves += [number(constant, real) for constant in program.constants]
    body = statements(
        program,
        leaves,
        lambda operation, name, value: f"const {'int' if operation in _CONDITIONS else real} {name} = {value};",
        EXPRESSIONS if real == "double" else _SINGLE,
    )
    return [*lines, *(f"  {line}" for line in body), "}", ""]


def _comment(program: Program | Walk, summary: str, descriptions: Mapping[str, str]) -> Iterable[str]:
    """Yield the lines that describe the function's arguments."""
    yield harmless(summary)
    arrays = [("parameters, the same for all poses", "p", program.parameters)]
    if isinstance(program, Walk):
        positions, targets = program.start.inputs[: program.nq], program.start.inputs[program.nq : -2]
        arrays = [("a closed configuration", "start", positions), ("targets", "targets", targets), *arrays]
    else:
        arrays = [("inputs", "x", program.inputs), *arrays]
    for title, array, names in arrays:
        yield ""
        yield f"{array}[{len(names)}], {title}:"
        yield from (f"  {array}[{k}]  {_described(name, descriptions)}" for k, name in enumerate(names))
    yield ""
    if isinstance(program, Walk):
        yield f"q[{program.nq}]: the configuration at the targets, written if the result is 0. Otherwise the result is"
        yield "1 if a singular configuration or another branch is on the way, 2 if the loops do not close,"
        yield "3 if an argument is not a number or too far away, 4 after max_steps Newton steps."
        return
    yield f"y[{len(program.results)}], outputs:"
    for group, shape in program.outputs.items():
        place = program.slices[group]
        last = f" .. y[{place.stop - 1}]" if place.stop - place.start > 1 else ""
        size = f"  ({' x '.join(map(str, shape))}, row by row)" if len(shape) > 1 else ""
        yield f"  y[{place.start}]{last}  {_described(group, descriptions)}{size}"


def _described(name: str, descriptions: Mapping[str, str]) -> str:
    return harmless(f"{name}: {descriptions[name]}" if name in descriptions else name)


def harmless(text: str) -> str:
    """Return text that does not end the comment it is put in."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\n", "\n * ")


def _table(program: Program | Walk, values: Vector) -> list[str]:
    if not len(values):
        return []
    rows = (
        f"  {number(value)}, /* {harmless(name)} */"
        for name, value in zip(program.parameters, values.tolist(), strict=True)
    )
    return [f"const double {program.name}_parameters[{len(values)}] = {{", *rows, "};", ""]


def number(value: float, real: Real = "double") -> str:
    """Return a number as a literal of a type; one of single precision is rounded once, from all digits."""
    text = literal(value, "NAN", "INFINITY")
    if real == "double" or not math.isfinite(value):
        return text
    return f"{text[:-1]}f)" if text.endswith(")") else f"{text}f"
