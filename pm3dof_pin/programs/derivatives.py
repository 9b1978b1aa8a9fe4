"""Derivatives of recorded numbers along given directions: forward differentiation, exact to rounding."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from pm3dof_pin.programs.graph import Number, Scalar, cos, is_zero, less, select, sin
from pm3dof_pin.programs.joints import objects
from pm3dof_pin.typing import Objects

_Tangent = tuple[Scalar, ...]


def derivatives(numbers: Objects, directions: Mapping[Number, Sequence[Scalar]]) -> Objects:
    """Record the derivatives of numbers, shape=(...), along k directions, shape=(..., k).

    Of `absolute`, `minimum`, `maximum` and `select` the derivative is that of the branch taken.

    Args:
        numbers: recorded numbers or constants.
        directions: by input, its rate in each of the k directions; inputs left out are at rest.
    """
    count = len(next(iter(directions.values()), ()))
    tangents: dict[Number, _Tangent | None] = {leaf: tuple(rates) for leaf, rates in directions.items()}
    for value in _in_order(numbers.ravel()):
        if value not in tangents:
            tangents[value] = _tangent(value, [tangents.get(operand) for operand in value.operands], count)
    rest = (0.0,) * count
    rows = [(tangents.get(x) or rest) if isinstance(x, Number) else rest for x in numbers.ravel()]
    return objects(rows).reshape(*numbers.shape, count)


def _in_order(roots: Iterable[Scalar]) -> list[Any]:
    """Return the values on which numbers depend, operands first."""
    found: set[Any] = set()
    waiting: list[Any] = [root for root in roots if isinstance(root, Number)]
    while waiting:
        value = waiting.pop()
        if value not in found:
            found.add(value)
            waiting.extend(value.operands)
    return sorted(found, key=lambda value: int(value.index))


def _tangent(value: Any, tangents: list[_Tangent | None], count: int) -> _Tangent | None:
    """Return the derivative of one operation along every direction; None if it is at rest."""
    if value.operation not in _RULES or not any(tangents):
        return None
    rest = (0.0,) * count
    rates = [tangent or rest for tangent in tangents]
    return tuple(_RULES[value.operation](value, *value.operands, *columns) for columns in zip(*rates, strict=True))


def _scaled(factor: Callable[[], Scalar], rate: Scalar) -> Scalar:
    """Return factor times rate, without recording the factor of a rate of zero."""
    return 0.0 if is_zero(rate) else factor() * rate


_RULES: dict[str, Callable[..., Scalar]] = {
    "negative": lambda _, a, da: -da,
    "add": lambda _, a, b, da, db: da + db,
    "subtract": lambda _, a, b, da, db: da - db,
    "multiply": lambda _, a, b, da, db: a * db + b * da,
    "divide": lambda v, a, b, da, db: (da - v * db) / b,
    "sqrt": lambda v, a, da: _scaled(lambda: 0.5 / v, da),
    "sin": lambda _, a, da: _scaled(lambda: cos(a), da),
    "cos": lambda _, a, da: _scaled(lambda: -sin(a), da),
    "atan2": lambda _, y, x, dy, dx: (x * dy - y * dx) / (x * x + y * y),
    "absolute": lambda _, a, da: select(less(a, 0.0), -da, da),
    "minimum": lambda _, a, b, da, db: select(less(a, b), da, db),
    "maximum": lambda _, a, b, da, db: select(less(b, a), da, db),
    # a condition is at rest
    "select": lambda _, condition, a, b, dc, da, db: select(condition, da, db),
}
