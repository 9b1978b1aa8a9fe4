"""Programs printed as JavaScript, for self-contained pages."""

from __future__ import annotations

from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.programs.printing import EXPRESSIONS, MAX_STEPS, literal, parameter_values, statements
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import SHORTEST_LEG, SINGULAR, Walk

_FUNCTIONS = ("sqrt", "sin", "cos", "atan2", "floor")
_EXPRESSIONS = EXPRESSIONS | {name: f"Math.{EXPRESSIONS[name]}" for name in _FUNCTIONS} | {"absolute": "Math.abs({0})"}


def javascript(program: Program | Walk, parameters: ArrayLike | None = None) -> str:
    """Print a program as a JavaScript function of arrays of double-precision numbers.

    A program is `function name(x, y)` with built-in parameter values, or `function name(x, p, y)` without: inputs x,
    parameters p, outputs y, which may be x. A walk is `function name(start, targets, q)`, or with p before q: it writes
    q if it arrives, and returns its status, see :data:`~pm3dof_pin.programs.walk.REACHED`, or 1 after too many Newton
    steps; its step is `name_step`.

    Raises:
        ShapeError: the number of values is not the number of parameters.
        InvalidValueError: the walk has no program that tells branches apart.
    """
    built_in = parameters is not None
    values = [] if parameters is None else parameter_values(program, parameters).tolist()
    p = "" if built_in else "p,"
    if isinstance(program, Program):
        return _function(program, program.name, values if built_in else None)
    walk, name = program, program.name
    if walk.branch is None:
        raise InvalidValueError("program", expected="a walk with a branch")
    stepped, state = len(walk.step.results), len(walk.start.results)
    functions = [_function(each, f"{name}_{part}", values if built_in else None) for part, each in walk.parts.items()]
    loop = f"""function {name}(start,targets,{p}q){{
"use strict";
const block=new Float64Array({stepped + state}),state=block.subarray({stepped});
{name}_start([...start,...targets,{SHORTEST_LEG!r},{walk.tolerance!r}],{p}state);
for(let k=0;k<{MAX_STEPS}&&state[{walk.status}]>0;k++){{
{name}_step(state,{p}block);
{name}_control(block,{p}state);
}}
if(state[{walk.status}]!==0)return state[{walk.status}];
const here=[0],there=[0],end=state.subarray({walk.reached.start},{walk.reached.stop});
{name}_branch(start,{p}here);
{name}_branch(end,{p}there);
if(here[0]!==there[0]&&!state[{walk.singular}])return {SINGULAR:g};
q.set(end);
return 0;
}}"""
    return "\n".join([*functions, loop])


def _function(program: Program, name: str, values: list[float] | None) -> str:
    leaves = [f"x[{k}]" for k in range(len(program.inputs))]
    leaves += [f"p[{k}]" for k in range(len(program.parameters))] if values is None else map(_literal, values)
    leaves += map(_literal, program.constants)
    lines = statements(program, leaves, lambda _, name, value: f"const {name}={value};", _EXPRESSIONS)
    return "\n".join([f"function {name}({'x,y' if values is not None else 'x,p,y'}){{", '"use strict";', *lines, "}"])


def _literal(value: float) -> str:
    return literal(value, "NaN", "Infinity")
