"""Programs printed as Python on arrays: for NumPy, JAX, PyTorch and CasADi, which differentiate them."""

from __future__ import annotations

from typing import Literal, TypeAlias

from pm3dof_pin.programs.printing import EXPRESSIONS, literal, value_lines
from pm3dof_pin.programs.program import Program

Library: TypeAlias = Literal["numpy", "jax", "torch", "casadi"]
"""Library whose functions are called, by the names that :data:`IMPORTS` gives them."""

IMPORTS: dict[Library, str] = {
    "numpy": """import numpy as np
from numpy import abs as fabs, arctan2 as atan2, cos, floor, sin, sqrt, where

_and, _or, _not = np.logical_and, np.logical_or, np.logical_not
""",
    "jax": """import jax
import numpy as np
from jax import numpy as jnp
from jax.numpy import abs as fabs, arctan2 as atan2, cos, floor, sin, sqrt, where

jax.config.update("jax_enable_x64", True)
_and, _or, _not = jnp.logical_and, jnp.logical_or, jnp.logical_not
""",
    "torch": """import numpy as np
import torch


def _tensor(value):  # PyTorch's functions take no plain numbers
    if torch.is_tensor(value):
        return value
    return torch.tensor(value, dtype=torch.bool if isinstance(value, bool) else torch.float64)


def _of(function):
    return lambda *values: function(*map(_tensor, values))


fabs, atan2, cos, floor, sin, sqrt, where = map(
    _of, (torch.abs, torch.atan2, torch.cos, torch.floor, torch.sin, torch.sqrt, torch.where)
)
_and, _or, _not = map(_of, (torch.logical_and, torch.logical_or, torch.logical_not))
""",
    "casadi": """import casadi
import numpy as np
from casadi import atan2, cos, fabs, floor, if_else as where, sin, sqrt

_and, _or, _not = casadi.logic_and, casadi.logic_or, casadi.logic_not
""",
}
"""Lines before printed programs."""

_EXPRESSIONS = EXPRESSIONS | {
    "minimum": "where(_or({0} < {1}, {0} != {0}), {0}, {1})",
    "maximum": "where(_or({1} < {0}, {0} != {0}), {0}, {1})",
    "and": "_and({0}, {1})",
    "or": "_or({0}, {1})",
    "not": "_not({0})",
    "select": "where({0}, {1}, {2})",
}


def array_code(program: Program, name: str) -> str:
    """Print a program as a Python function of lists of arrays, for any :data:`Library`.

    ``name(x, p)`` has the inputs x, one array each, and the parameters p, and returns the outputs as a list, in which
    constants are numbers.
    """
    leaves = [f"x[{k}]" for k in range(len(program.inputs))] + [f"p[{k}]" for k in range(len(program.parameters))]
    leaves += [literal(value, 'float("nan")', 'float("inf")') for value in program.constants]
    lines, results = value_lines(program, leaves, lambda _, value, text: f"{value} = {text}", _EXPRESSIONS)
    rows = [f"        {', '.join(results[k : k + 10])}," for k in range(0, len(results), 10)]
    return "\n".join([f"def {name}(x, p):", *(f"    {line}" for line in lines), "    return [", *rows, "    ]", ""])
