"""The springs of a mechanism: what they are, and reading them from the `springs` of a closures file.

An entry is a mapping with a `name`, a `type` and the keys of that type:

- joint: a spring at a joint with one freedom; `joint`, `stiffness`, `unit` (N/m, or N m/rad).
- axial: give along an axis; `at`, `axis`, `stiffness`, `unit: N/m`.
- cantilever: the tip of an Euler-Bernoulli cantilever; `at`, `axis`, `bending_stiffness` (E I), `torsional_stiffness`
  (G J), `unit: N m^2`, `length`, a number [m] or {joint, at_zero}; axially rigid unless there is `axial_stiffness` [N],
  its E A.
- beam: any 6 x 6 stiffness of a tip; `at`, `matrix`.
- closure: a loop closure that is not rigid; `closure`, its position in the list of closures, counted from 0; `matrix`,
  3 x 3 or 6 x 6.

`at` is a joint or frame; what hangs on it, itself included, moves when the spring gives. Axes and matrices are in the
axes of `at` (of the closure's first frame), in the order x, y, z, rx, ry, rz [N/m, N, N m/rad].
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.typing import Matrix

JointSpringUnit = Literal["N/m", "N m/rad"]

_SYMMETRY = 1e-9
_DEFINITENESS = 1e-12


@dataclass(frozen=True)
class JointSpring:
    """A spring at a joint with one freedom: an actuator's or a bearing's. At rest in the configuration looked at.

    Attributes:
        name: its name.
        joint: the joint.
        stiffness: k [N/m or N m/rad].
        unit: "N/m" for a joint that translates, "N m/rad" for one that turns.
    """

    name: str
    joint: str
    stiffness: float
    unit: JointSpringUnit

    def __post_init__(self) -> None:
        """Check the number."""
        _require_positive("stiffness", self.stiffness)


@dataclass(frozen=True)
class AxialSpring:
    """A body that gives along one axis: a link, a ball screw.

    Attributes:
        name: its name.
        at: joint or frame that moves when the spring gives, with all that hangs on it.
        axis: direction in the axes of `at`, made a unit vector.
        stiffness: k [N/m].
    """

    name: str
    at: str
    axis: tuple[float, float, float]
    stiffness: float

    def __post_init__(self) -> None:
        """Check the numbers."""
        object.__setattr__(self, "axis", _unit_vector(self.axis))
        _require_positive("stiffness", self.stiffness)


@dataclass(frozen=True)
class JointLength:
    """A length that a joint changes, L = at_zero + q.

    Attributes:
        joint: a joint with one freedom that translates.
        at_zero: L where the joint stands at zero [m].
    """

    joint: str
    at_zero: float

    def __post_init__(self) -> None:
        """Check the number."""
        if not np.isfinite(self.at_zero):
            raise InvalidValueError("length: at_zero", self.at_zero, "a finite length in metres")


@dataclass(frozen=True)
class CantileverSpring:
    """The tip of a straight, uniform, slender cantilever (Euler-Bernoulli, small deflections).

    Attributes:
        name: its name.
        at: joint or frame at the tip.
        axis: direction of the beam, from clamp to tip, in the axes of `at`; made a unit vector.
        bending_stiffness: E I, the same about every axis across [N m^2].
        torsional_stiffness: G J [N m^2].
        length: L [m], or the joint that changes it.
        axial_stiffness: E A [N]; None for a beam that is rigid (or held by something else) along its axis.
    """

    name: str
    at: str
    axis: tuple[float, float, float]
    bending_stiffness: float
    torsional_stiffness: float
    length: float | JointLength
    axial_stiffness: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        object.__setattr__(self, "axis", _unit_vector(self.axis))
        _require_positive("bending_stiffness", self.bending_stiffness)
        _require_positive("torsional_stiffness", self.torsional_stiffness)
        if self.axial_stiffness is not None:
            _require_positive("axial_stiffness", self.axial_stiffness)
        if not isinstance(self.length, JointLength):
            _require_positive("length", self.length)


@dataclass(frozen=True, eq=False)
class BeamSpring:
    """A body between two ends with any 6 x 6 stiffness at its tip.

    Attributes:
        name: its name.
        at: joint or frame at the tip.
        matrix: stiffness, shape=(6, 6) [N/m, N, N m/rad]; read-only.
    """

    name: str
    at: str
    matrix: Matrix

    def __post_init__(self) -> None:
        """Check the numbers."""
        object.__setattr__(self, "matrix", _positive_definite("matrix", self.matrix, (6,)))


@dataclass(frozen=True, eq=False)
class ClosureSpring:
    """A loop closure that gives: a bushing, a bearing.

    Attributes:
        name: its name.
        closure: position of the closure in the mechanism's list.
        matrix: stiffness, shape=(3, 3) for a 3d closure, (6, 6) for a 6d one [N/m, N, N m/rad]; read-only.
    """

    name: str
    closure: int
    matrix: Matrix

    def __post_init__(self) -> None:
        """Check the numbers."""
        object.__setattr__(self, "matrix", _positive_definite("matrix", self.matrix, (3, 6)))


Spring: TypeAlias = JointSpring | AxialSpring | CantileverSpring | BeamSpring | ClosureSpring

_KEYS: dict[str, tuple[frozenset[str], frozenset[str]]] = {
    "joint": (frozenset({"joint", "stiffness", "unit"}), frozenset()),
    "axial": (frozenset({"at", "axis", "stiffness", "unit"}), frozenset()),
    "cantilever": (
        frozenset({"at", "axis", "bending_stiffness", "torsional_stiffness", "length", "unit"}),
        frozenset({"axial_stiffness"}),
    ),
    "beam": (frozenset({"at", "matrix"}), frozenset()),
    "closure": (frozenset({"closure", "matrix"}), frozenset()),
}
"""Keys that a type must have beside `name` and `type`, and those that it may have."""

_UNITS = {"joint": ("N/m", "N m/rad"), "axial": ("N/m",), "cantilever": ("N m^2",)}


def read_springs(entries: Iterable[Mapping[str, Any]], source: Path | str) -> tuple[Spring, ...]:
    """Read the `springs` of a closures file. Whether the joints and frames exist is for the mechanism to say.

    Args:
        entries: :attr:`~pm3dof_pin.description.closures.ClosuresFile.springs`.
        source: the file, for messages.

    Raises:
        DescriptionError: an entry has no name or one that is taken, an unknown type, a key missing or too many, a wrong
            unit, a number that is not finite and positive, or a matrix that is not symmetric and positive definite.
    """
    springs: list[Spring] = []
    for index, entry in enumerate(entries):
        spring = _Entry(entry, source, index).spring()
        if spring.name in {other.name for other in springs}:
            raise DescriptionError(source, f"springs[{index}]", f"the name '{spring.name}' is taken, expected another")
        springs.append(spring)
    return tuple(springs)


class _Entry:
    """One entry of `springs`, with errors that say where it stands."""

    def __init__(self, entry: Mapping[str, Any], source: Path | str, index: int) -> None:
        self._entry = entry
        self._source = source
        self._element = f"springs[{index}]"
        name = self._text("name")
        self._element += f" '{name}'"
        self._name = name

    def spring(self) -> Spring:
        kind = self._entry.get("type")
        if not isinstance(kind, str) or kind not in _KEYS:
            raise self._error("type", f"expected one of {', '.join(_KEYS)}, not {kind}")
        self._check_keys(kind)
        try:
            return self._of_type(kind)
        except InvalidValueError as error:
            raise self._error(error.name, f"is {error.value}, expected {error.expected}") from error

    def _of_type(self, kind: str) -> Spring:
        if kind == "joint":
            unit: JointSpringUnit = "N/m" if self._entry["unit"] == "N/m" else "N m/rad"
            return JointSpring(self._name, self._text("joint"), self._number("stiffness"), unit)
        if kind == "axial":
            return AxialSpring(self._name, self._text("at"), self._axis(), self._number("stiffness"))
        if kind == "cantilever":
            return CantileverSpring(
                name=self._name,
                at=self._text("at"),
                axis=self._axis(),
                bending_stiffness=self._number("bending_stiffness"),
                torsional_stiffness=self._number("torsional_stiffness"),
                length=self._length(),
                axial_stiffness=self._number("axial_stiffness") if "axial_stiffness" in self._entry else None,
            )
        if kind == "beam":
            return BeamSpring(self._name, self._text("at"), self._matrix())
        return ClosureSpring(self._name, self._position("closure"), self._matrix())

    def _check_keys(self, kind: str) -> None:
        needed, optional = _KEYS[kind]
        for key in self._entry:
            if key not in needed | optional | {"name", "type"}:
                raise self._error(
                    str(key), f"unknown key of type {kind}, expected some of {_listed(needed | optional)}"
                )
        for key in sorted(needed - set(self._entry)):
            raise self._error(key, f"is missing, type {kind} needs {_listed(needed)}")
        if kind in _UNITS and self._entry["unit"] not in _UNITS[kind]:
            raise self._error("unit", f"expected {' or '.join(_UNITS[kind])}, not {self._entry['unit']}")

    def _text(self, key: str) -> str:
        value = self._entry.get(key)
        if not isinstance(value, str) or not value:
            raise self._error(key, f"expected a name, not {value}")
        return value

    def _number(self, key: str) -> float:
        return self._as_number(key, self._entry[key])

    def _as_number(self, key: str, value: Any) -> float:
        # YAML 1.1 takes 9.5e7, without a sign in the exponent, for a string
        if not isinstance(value, bool) and isinstance(value, (int, float, str)):
            try:
                return float(value)
            except ValueError:
                pass
        raise self._error(key, f"expected a number, not {value}")

    def _position(self, key: str) -> int:
        value = self._entry[key]
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self._error(key, f"expected a position in closed_loop, counted from 0, not {value}")
        return value

    def _axis(self) -> tuple[float, float, float]:
        value = self._entry["axis"]
        if not isinstance(value, list) or len(value) != 3:
            raise self._error("axis", f"expected three numbers, not {value}")
        x, y, z = (self._as_number("axis", number) for number in value)
        return x, y, z

    def _length(self) -> float | JointLength:
        value = self._entry["length"]
        if not isinstance(value, dict):
            return self._as_number("length", value)
        if set(value) != {"joint", "at_zero"} or not isinstance(value["joint"], str):
            raise self._error("length", f"expected a number or {{joint: name, at_zero: number}}, not {value}")
        return JointLength(value["joint"], self._as_number("length: at_zero", value["at_zero"]))

    def _matrix(self) -> Matrix:
        value = self._entry["matrix"]
        if not isinstance(value, list) or not all(isinstance(row, list) and len(row) == len(value) for row in value):
            raise self._error("matrix", "expected a list of rows, as many as they are long")
        return np.array([[self._as_number("matrix", number) for number in row] for row in value])

    def _error(self, key: str, expected: str) -> DescriptionError:
        return DescriptionError(self._source, f"{self._element}: {key}", expected)


def _listed(keys: Iterable[str]) -> str:
    return ", ".join(sorted(keys))


def _require_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise InvalidValueError(name, value, "a positive, finite number")


def _unit_vector(axis: ArrayLike) -> tuple[float, float, float]:
    vector = np.asarray(axis, dtype=float)
    length = np.linalg.norm(vector) if vector.shape == (3,) else np.nan
    if not (np.isfinite(length) and length > 0.0):
        raise InvalidValueError("axis", axis, "three finite numbers, not all zero")
    x, y, z = (float(component) for component in vector / length)
    return x, y, z


def _positive_definite(name: str, matrix: ArrayLike, sizes: tuple[int, ...]) -> Matrix:
    """Return a read-only, exactly symmetric copy. Judged at a unit diagonal: N/m stands beside N m/rad."""
    array = np.array(matrix, dtype=float)
    if array.shape not in {(size, size) for size in sizes}:
        expected = " or ".join(f"{size} x {size}" for size in sizes)
        raise InvalidValueError(name, f"of shape {array.shape}", expected)
    diagonal = array.diagonal()
    if not np.isfinite(array).all() or not (diagonal > 0.0).all():
        raise InvalidValueError(name, array.tolist(), "finite numbers and a positive diagonal")
    scale = np.sqrt(diagonal)
    scaled = array / np.outer(scale, scale)
    if np.abs(scaled - scaled.T).max() > _SYMMETRY:
        raise InvalidValueError(name, array.tolist(), "a symmetric matrix")
    if np.linalg.eigvalsh(scaled)[0] < _DEFINITENESS:
        raise InvalidValueError(name, array.tolist(), "a positive definite matrix")
    symmetric: Matrix = 0.5 * (array + array.T)
    symmetric.setflags(write=False)
    return symmetric
