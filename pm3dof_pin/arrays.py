"""Input arrays checked, output arrays made read-only."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError, ShapeError
from pm3dof_pin.typing import Vector

MAX_MAGNITUDE = 1e100  # the product of any three is a number
_LARGE = 2**26  # bytes
_LISTED = 18  # numbers of a vector in a message
_NOTHING = 1e-14  # numbers of smaller size are listed as 0
AnyArray = TypeVar("AnyArray", bound=NDArray[Any])


def real_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return values as an array of real numbers; `name` is for messages.

    Strings, booleans, complex and masked values are refused, even where NumPy would convert them.

    Raises:
        InvalidValueError: they are not real numbers, or are ragged.
    """
    try:
        array = np.asarray(values)
        # without numpy.ma loaded there are no masked arrays, and loading it is slow
        if "numpy.ma" in sys.modules and np.ma.is_masked(values):
            raise InvalidValueError(name, values, "no masked numbers")
        if array.dtype.kind not in "iufO" or any(isinstance(entry, (str, bytes, bool)) for entry in _objects(array)):
            raise InvalidValueError(name, values, "real numbers")
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidValueError(name, values, "real numbers") from error


def median(values: ArrayLike) -> Any:
    """Return the median of finite numbers along the first axis; NumPy's own loads numpy.ma, which takes 20 ms."""
    ordered = np.sort(values, axis=0)
    return 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])


def _objects(array: NDArray[Any]) -> Iterable[Any]:
    return array.flat if array.dtype.kind == "O" else ()


def finite_array(name: str, values: ArrayLike, *shapes: tuple[int, ...]) -> NDArray[np.float64]:
    """Copy values into an array of finite numbers with one of the given shapes; `name` is for messages.

    Raises:
        InvalidValueError: they are not numbers, not finite, or have another shape.
    """
    array = np.array(real_array(name, values))
    if array.shape not in shapes:
        raise ShapeError(name, array.shape, f"{' or '.join(map(str, shapes))}")
    if not (np.abs(array) <= MAX_MAGNITUDE).all():  # also catches NaN
        raise InvalidValueError(name, array, f"finite numbers of at most {MAX_MAGNITUDE:g}")
    return array


def require_choice(name: str, value: object, choices: Any) -> None:
    """Raise InvalidValueError unless a value is one of the strings of a `Literal`."""
    if not isinstance(value, str) or value not in get_args(choices):
        raise InvalidValueError(name, value, " or ".join(map(repr, get_args(choices))))


def require_count(name: str, value: object, least: int = 1) -> None:
    """Raise InvalidValueError unless a value is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InvalidValueError(name, value, f"a whole number of at least {least}")


def require_kind(name: str, value: object, kind: type, origin: str) -> None:
    """Raise InvalidValueError unless a value is an instance of a class; `origin` says where to get one."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InvalidValueError(name, value, f"{article} {kind.__name__}, as returned by {origin}")


def listed(numbers: Vector) -> str:
    """Format a vector in one line for a message: (0.1 0 -2.5); of a long one the first numbers."""
    shown = [f"{0.0 if abs(number) < _NOTHING else number:.4g}" for number in numbers[:_LISTED]]
    return f"({' '.join(shown)}{f' and {len(numbers) - _LISTED} more' if len(numbers) > _LISTED else ''})"


def frozen(array: AnyArray) -> AnyArray:
    """Make an array read-only and return it."""
    array.setflags(write=False)
    return array


def large_array(shape: int | tuple[int, ...], dtype: type = np.float64) -> NDArray[Any]:
    """Return zeros: of many in a temporary file without a name, which the system keeps in memory as far as there is."""
    if np.prod(shape) * np.dtype(dtype).itemsize < _LARGE:
        return np.zeros(shape, dtype)
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, dtype, mode="w+", shape=shape)
