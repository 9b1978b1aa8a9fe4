"""Arrays on their way in, checked, and on their way out, read-only."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Vector

_GREATEST = 1e100  # the product of any three is a number
_Array = TypeVar("_Array", bound=NDArray[Any])


def real_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return values, named for messages, as an array of real numbers.

    Texts, truth values and complex numbers are none, even where NumPy would read them, and neither are masked ones.

    Raises:
        InvalidValueError: they are no real numbers, or not of one shape.
    """
    try:
        array = np.asarray(values)
        # nobody who has not loaded numpy.ma has a masked array, and loading it takes long
        if "numpy.ma" in sys.modules and np.ma.is_masked(values):
            raise InvalidValueError(name, values, "no masked numbers")
        if array.dtype.kind not in "iufO" or any(isinstance(entry, (str, bytes, bool)) for entry in _objects(array)):
            raise InvalidValueError(name, values, "real numbers")
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidValueError(name, values, "real numbers") from error


def _objects(array: NDArray[Any]) -> Iterable[Any]:
    return array.flat if array.dtype.kind == "O" else ()


def finite_array(name: str, values: ArrayLike, *shapes: tuple[int, ...]) -> NDArray[np.float64]:
    """Copy values, named for messages, into an array of finite numbers of one of some shapes.

    Raises:
        InvalidValueError: they are not numbers, not finite, or of another shape.
    """
    array = np.array(real_array(name, values))
    if array.shape not in shapes:
        raise InvalidValueError(name, f"an array of shape {array.shape}", f"shape {' or '.join(map(str, shapes))}")
    if not (np.abs(array) <= _GREATEST).all():  # so for NaN
        raise InvalidValueError(name, array, f"finite numbers of at most {_GREATEST:g}")
    return array


def require_choice(name: str, value: object, choices: Any) -> None:
    """Raise InvalidValueError unless a value is one of the words of a `Literal`."""
    if not isinstance(value, str) or value not in get_args(choices):
        raise InvalidValueError(name, value, " or ".join(map(repr, get_args(choices))))


def require_count(name: str, value: object, least: int = 1) -> None:
    """Raise InvalidValueError unless a value is a whole number, and large enough."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InvalidValueError(name, value, f"a whole number from {least} on")


def require_kind(name: str, value: object, kind: type, origin: str) -> None:
    """Raise InvalidValueError unless a value is an object of a class, which `origin` gives."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InvalidValueError(name, value, f"{article} {kind.__name__}, as {origin} gives")


def with_neighbours(mask: NDArray[np.bool_], *, closed: int | None = None) -> NDArray[np.bool_]:
    """Return a mask of what is in another or next to it, corner to corner too; the axis `closed` runs round."""
    grown = mask.copy()
    for axis in range(mask.ndim):
        along = np.moveaxis(grown, axis, 0)
        before = along.copy()
        along[1:] |= before[:-1]
        along[:-1] |= before[1:]
        if axis == closed:
            along[0] |= before[-1]
            along[-1] |= before[0]
    return grown


def listed(numbers: Vector) -> str:
    """Write the numbers of a vector in one line, for a message: (0.1 0 -2.5)."""
    return f"({' '.join(f'{number:.4g}' for number in numbers)})"


def frozen(array: _Array) -> _Array:
    """Make an array read-only and return it."""
    array.setflags(write=False)
    return array
