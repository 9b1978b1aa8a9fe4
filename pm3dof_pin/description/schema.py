"""Check plain data against a schema, with errors that name the file and the place in it.

The schemas use msgspec: it checks as precisely as Pydantic and imports in 10 ms instead of 140.
"""

from __future__ import annotations

import math
import re
import reprlib
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from pm3dof_pin.description.physical_bounds import LENGTH, STIFFNESS
from pm3dof_pin.exceptions import DescriptionError

T = TypeVar("T")

Name = Annotated[str, msgspec.Meta(min_length=1)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Stiffness = Annotated[float, msgspec.Meta(ge=STIFFNESS.least, le=STIFFNESS.greatest)]
Length = Annotated[float, msgspec.Meta(ge=-LENGTH.greatest, le=LENGTH.greatest)]
PositiveLength = Annotated[float, msgspec.Meta(gt=0.0, le=LENGTH.greatest)]
LengthTolerance = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
AngleTolerance = Annotated[float, msgspec.Meta(gt=0.0, le=0.5)]

_PLACE = re.compile(r" - at `(key` in `)?\$\.?(.*)`$")
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`")
_MISSING = re.compile(r"Object missing required field `(.*)`")
_WORDS = {
    "object": "a mapping",
    "array": "a list",
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
}


class Schema(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A mapping with exactly these fields as keys."""


def checked(data: Any, schema: type[T], path: Path | str, element: str = "") -> T:
    """Convert plain data to an object of a schema; messages name file and element.

    Numbers may be strings, since YAML 1.1 reads 9.5e7, without a sign in the exponent, as a string.

    Raises:
        DescriptionError: the data does not fit the schema, has an unknown key, or contains a number that is not finite.
    """
    try:
        result = msgspec.convert(data, schema, strict=False)
    except msgspec.ValidationError as error:
        place, expected = _place_and_expected(str(error), data, schema)
        raise DescriptionError(path, _joined(element, place) or "file", expected) from error
    for place, number in _numbers(msgspec.to_builtins(result)):
        if not math.isfinite(number):
            raise DescriptionError(path, _joined(element, place), f"expected a finite number, not {number}")
    return result


def _place_and_expected(message: str, data: Any, schema: Any) -> tuple[str, str]:
    """Turn a msgspec message into a place in the data and what was expected there."""
    found = _PLACE.search(message)
    place, problem = (found[2], message[: found.start()]) if found else ("", message)
    if found and found[1]:
        return place, "expected names as keys"
    place, value, form = _at(place, data, schema)
    if unknown := _UNKNOWN.fullmatch(problem):
        return _joined(place, unknown[1]), f"unknown key, expected some of {', '.join(sorted(_fields(form)))}"
    if missing := _MISSING.fullmatch(problem):
        needed = _fields(form).get(missing[1])
        words = f", expected {' or '.join(map(str, get_args(needed)))}" if get_origin(needed) is Literal else ""
        return _joined(place, missing[1]), f"is missing{words}"
    if problem.startswith("Invalid enum value"):
        return place, f"expected one of {', '.join(map(str, get_args(form)))}, not {reprlib.repr(value)}"
    if str(value).lstrip("+-").lower() in ("nan", "inf", "infinity"):
        return place, f"expected a finite number, not {value}"
    expected = re.sub(r", got .*", "", problem).removeprefix("Expected ")
    expected = re.sub(r"`([\w |]+)`", lambda kinds: _in_words(kinds[1]), expected)
    return place, f"expected {expected}, not {reprlib.repr(value)}"


def _in_words(kinds: str) -> str:
    return " or ".join(_WORDS.get(kind, kind) for kind in kinds.split(" | ") if kind != "null")


def _at(place: str, data: Any, schema: Any) -> tuple[str, Any, Any]:
    """Return msgspec's place spelt out, the value there, and the part of the schema that applies."""
    spelt, schema = "", _plain(schema, data)
    for index, key in re.findall(r"\[(\d+|\.\.\.)\]|([^.\[\]]+)", place):
        arguments = get_args(schema)
        if index == "...":  # some value of a mapping with free keys: msgspec does not say which
            schema = arguments[1]
            key = next(key for key, value in data.items() if not _fits(value, schema))
            spelt, data = _joined(spelt, key), data[key]
        elif index:
            schema = arguments[int(index)] if get_origin(schema) is tuple else arguments[0]
            spelt, data = f"{spelt}[{index}]", data[int(index)]
        else:
            spelt, data, schema = _joined(spelt, key), data.get(key), _fields(schema)[key]
        schema = _plain(schema, data)
    return spelt, data, schema


def _fits(value: Any, schema: Any) -> bool:
    try:
        msgspec.convert(value, schema, strict=False)
    except msgspec.ValidationError:
        return False
    return True


def _plain(schema: Any, data: Any) -> Any:
    """Remove the annotations of a type; of a union return the member that matches the data."""
    if get_origin(schema) is Annotated:
        return _plain(get_args(schema)[0], data)
    if get_origin(schema) not in (Union, types.UnionType):
        return schema
    members = [_plain(member, data) for member in get_args(schema)]
    return max(members, key=lambda member: _likeness(member, data))


def _likeness(member: Any, data: Any) -> bool:
    if isinstance(data, dict):
        return hasattr(member, "__struct_fields__")
    origin: Any = get_origin(member)
    return origin in (list, tuple) if isinstance(data, list) else origin is Literal


def _fields(schema: Any) -> dict[str, Any]:
    return get_type_hints(schema, include_extras=True) if hasattr(schema, "__struct_fields__") else {}


def _joined(place: str, key: str) -> str:
    return f"{place}.{key}" if place and key and not key.startswith("[") else f"{place}{key}"


def _numbers(data: Any, place: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _numbers(value, _joined(place, str(key)))
    elif isinstance(data, (list, tuple)):
        for index, value in enumerate(data):
            yield from _numbers(value, f"{place}[{index}]")
    elif isinstance(data, float):
        yield place, data
