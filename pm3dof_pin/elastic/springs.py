"""The springs of a mechanism, and reading them from the `springs` of a closures file.

An entry is a mapping with a `name`, a `type` and the keys of that type:

- joint: a spring at a single-DoF joint; `joint`, `stiffness`, `unit` (N/m, or N m/rad).
- axial: elastic along an axis; `at`, `axis`, `stiffness`, `unit: N/m`.
- cantilever: the tip of a cantilever; `at`, `axis`, `bending_stiffness` (E I), `torsional_stiffness` (G J),
  `unit: N m^2`, `length`, a number [m] or {joint, at_zero}; axially rigid unless there is `axial_stiffness` [N], its
  E A; `shear_stiffness` [N], its k G A (Timoshenko). Without it a beam is rigid in shear (Euler-Bernoulli), unless its
  E A or `thickness` [m] gives the section and it is stubby: then it has that of a round bar, and a warning says so;
  `rigid` declines.
  `mass` [kg], the part of the body before it that bends with it, and its `mass_model`, consistent (by default) or
  lumped; `elements`, the number of equal elements, by default 1.
- beam: any 6 x 6 stiffness of a tip; `at`, `matrix`.
- closure: an elastic loop closure; `closure`, its index in the list of closures, from 0; `matrix`, with a row for each
  component that the closure holds, 3 x 3 for type 3d, 6 x 6 for 6d.

An axial spring, one at a prismatic joint and an isotropic closure spring of type 3d may have a `law`, by which they are
contacts (:mod:`pm3dof_pin.elastic.contact_laws`): `preload` [N], `play` [m] or `doubles_at` [m], `exponent` and `load`.
Or `contact` names one of the catalogue (:mod:`pm3dof_pin.elastic.contact_catalogue`), which has stiffness and law.

Any of them may declare a `loss_factor`, for vibration, and a joint's spring a viscous `damping` (N s/m, N m s/rad).

`at` is a joint or frame; it and everything attached to it move when the spring deflects. Axes and matrices are in the
axes of `at` (of the closure's first frame), in the order x, y, z, rx, ry, rz [N/m, N, N m/rad].
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, get_args

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.description.physical_bounds import STIFFNESS
from pm3dof_pin.description.schema import Length, Name, Positive, PositiveLength, Schema, Stiffness, checked
from pm3dof_pin.elastic.contact_catalogue import contacts
from pm3dof_pin.elastic.contact_laws import ContactLaw
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.tolerances import ROUNDING, SOLVED
from pm3dof_pin.typing import Matrix

JointSpringUnit = Literal["N/m", "N m/rad"]
RIGID: Literal["rigid"] = "rigid"
"""Shear stiffness of a beam that declines the default."""

MassModel = Literal["consistent", "lumped"]

_log = logging.getLogger(__name__)

STUBBY = 0.05
"""Lateral give by shear relative to that by bending, from which on it counts."""

MAX_ELEMENTS = 100
"""Largest number of elements of one cantilever."""


@dataclass(frozen=True)
class JointSpring:
    """A spring at a single-DoF joint, such as an actuator or a bearing, at rest in the given configuration."""

    name: str  #: its name
    joint: str  #: the joint
    stiffness: float  #: k [N/m or N m/rad]
    unit: JointSpringUnit  #: "N/m" for a prismatic joint, "N m/rad" for a revolute one
    loss_factor: float | None = None  #: eta of k (1 + i eta), in vibration; None if unknown
    damping: float | None = None  #: viscous damper beside it [N s/m or N m s/rad]; None if unknown
    law: ContactLaw | None = None  #: of a contact, at a prismatic joint; None for a linear spring

    def __post_init__(self) -> None:
        """Check the numbers."""
        _require_positive("stiffness", self.stiffness)
        _require_damping(self.loss_factor, self.damping)
        if self.law is not None and self.unit != "N/m":
            raise InvalidValueError("law", problem="is of a revolute joint", expected="a prismatic joint")


@dataclass(frozen=True)
class AxialSpring:
    """A body that is elastic along one axis: a link, a ball screw."""

    name: str  #: its name
    at: str  #: joint or frame that moves when the spring deflects, with everything attached to it
    axis: tuple[float, float, float]  #: direction in the axes of `at`, normalised
    stiffness: float  #: k [N/m]
    loss_factor: float | None = None  #: eta of k (1 + i eta), in vibration; None if unknown
    law: ContactLaw | None = None  #: of a contact; None for a linear spring

    def __post_init__(self) -> None:
        """Check the numbers."""
        object.__setattr__(self, "axis", _unit_vector(self.axis))
        _require_positive("stiffness", self.stiffness)
        _require_damping(self.loss_factor)


class JointLength(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A length changed by a prismatic joint, L = at_zero + q [m]."""

    joint: Name
    at_zero: Length

    def __post_init__(self) -> None:
        """Check the number."""
        if not np.isfinite(self.at_zero):
            raise InvalidValueError("length: at_zero", self.at_zero, "a finite length in metres")


@dataclass(frozen=True)
class CantileverSpring:
    """The tip of a straight, uniform cantilever: Timoshenko's beam, or Euler and Bernoulli's if rigid in shear.

    Small deflections: the compliance is L^3 / (3 E I) + L / (k G A), L^2 / (2 E I), L / (E I), L / (G J) and L / (E A).
    Its mass belongs to the rigid body before it, and moves as the beam bends in vibration.
    """

    name: str  #: its name
    at: str  #: joint or frame at the tip
    #: direction of the beam, from clamp to tip, in the axes of `at`; normalised
    axis: tuple[float, float, float]
    bending_stiffness: float  #: E I, equal about all transverse axes [N m^2]
    torsional_stiffness: float  #: G J [N m^2]
    length: float | JointLength  #: L [m], or the joint that changes it
    #: E A [N]; None for a beam that is axially rigid (or held axially by something else)
    axial_stiffness: float | None = None
    elements: int = 1  #: number of equal elements it is divided into, for large deflections and buckling
    #: k G A [N], with the shear coefficient k of its section (G. Cowper, J. Applied Mechanics 33, 1966); None for a
    #: slender beam, rigid in shear
    shear_stiffness: float | None = None
    #: mass of the beam [kg], contained in the body at its clamp. Its weight, and if `mass_model` is lumped its inertia,
    #: is in lumps: one element moves 33/140 of it with the tip, as in the first mode of a uniform beam (J. Rayleigh);
    #: several have half of their part at either end
    mass: float = 0.0
    loss_factor: float | None = None  #: eta of k (1 + i eta), in vibration; None if unknown
    thickness: float | None = None  #: diameter of a round bar [m], by which shear is judged; None if unknown
    #: of vibrations: "consistent" with the bending line (:mod:`pm3dof_pin.dynamics.beam_masses`), or "lumped"
    mass_model: MassModel = "consistent"

    @property
    def components(self) -> tuple[str, ...]:
        """The motions of an element's end, in the order of its stiffness."""
        motions = tuple(motion for motion in TOOL_COMPONENTS if motion != "z" or self.axial_stiffness is not None)
        return motions if self.shear_stiffness is None else (*motions, "shear_x", "shear_y")

    @property
    def squared_gyration_radius(self) -> float:
        """Squared radius of gyration of the section about a diameter, of a round bar [m^2]; 0 if it is unknown."""
        if self.thickness is not None:
            return self.thickness**2 / 16.0
        return 0.0 if self.axial_stiffness is None else self.bending_stiffness / self.axial_stiffness

    def shear_share(self, length: float) -> float:
        """Return the lateral give by shear relative to that by bending at a length [m], if shear were counted.

        With k G A of a solid round bar: its radius is half the thickness, or that of E I and E A; Poisson's ratio is
        that of E I and G J, the shear coefficient that of G. Cowper (J. Applied Mechanics 33, 1966). 0 if neither
        thickness nor E A is known.
        """
        shear = self.estimated_shear_stiffness
        return 0.0 if shear is None else 3.0 * self.bending_stiffness / (shear * length**2)

    @property
    def estimated_shear_stiffness(self) -> float | None:
        """Shear stiffness k G A of :meth:`shear_share` [N]; None if the section is unknown."""
        if self.thickness is not None:
            radius_squared = 0.25 * self.thickness**2
        elif self.axial_stiffness is not None:
            radius_squared = 4.0 * self.bending_stiffness / self.axial_stiffness
        else:
            return None
        poisson = min(max(self.bending_stiffness / self.torsional_stiffness - 1.0, 0.0), 0.5)
        coefficient = 6.0 * (1.0 + poisson) / (7.0 + 6.0 * poisson)
        return coefficient * 4.0 * self.bending_stiffness / radius_squared / (2.0 * (1.0 + poisson))

    def __post_init__(self) -> None:
        """Check the numbers."""
        _require_damping(self.loss_factor)
        object.__setattr__(self, "axis", _unit_vector(self.axis))
        _require_positive("bending_stiffness", self.bending_stiffness)
        if self.thickness is not None and not 0.0 < self.thickness < np.inf:
            raise InvalidValueError("thickness", self.thickness, "a positive length")
        _require_positive("torsional_stiffness", self.torsional_stiffness)
        for name in ("axial_stiffness", "shear_stiffness"):
            if (value := getattr(self, name)) is not None:
                _require_positive(name, value)
        if not 0.0 <= self.mass < np.inf:
            raise InvalidValueError("mass", self.mass, "a finite mass, not negative")
        if not isinstance(self.length, JointLength):
            _require_positive("length", self.length)
        if not 1 <= self.elements <= MAX_ELEMENTS:
            raise InvalidValueError("elements", self.elements, f"a number from 1 to {MAX_ELEMENTS}")
        if self.elements > 1 and isinstance(self.length, JointLength):
            raise InvalidValueError("elements", self.elements, "1, since a joint changes the length")
        if self.mass_model not in get_args(MassModel):
            raise InvalidValueError("mass_model", self.mass_model, " or ".join(get_args(MassModel)))


@dataclass(frozen=True, eq=False)
class BeamSpring:
    """A body between two ends with any 6 x 6 stiffness at its tip."""

    name: str  #: its name
    at: str  #: joint or frame at the tip
    matrix: Matrix  #: stiffness, shape=(6, 6) [N/m, N, N m/rad]; read-only
    loss_factor: float | None = None  #: eta of k (1 + i eta), in vibration; None if unknown

    def __post_init__(self) -> None:
        """Check the numbers."""
        _require_damping(self.loss_factor)
        object.__setattr__(self, "matrix", _positive_definite("matrix", self.matrix, (6,)))


@dataclass(frozen=True, eq=False)
class ClosureSpring:
    """An elastic loop closure: a bushing, a bearing."""

    name: str  #: its name
    closure: int  #: index of the closure in the mechanism's list
    #: stiffness by the components that the closure holds, in the axes of its first frame, shape=(3, 3) for a 3d
    #: closure, (6, 6) for a 6d one [N/m, N, N m/rad]; read-only
    matrix: Matrix
    loss_factor: float | None = None  #: eta of k (1 + i eta), in vibration; None if unknown
    law: ContactLaw | None = None  #: of a contact that is alike in all directions of a 3d closure; None if linear

    def __post_init__(self) -> None:
        """Check the numbers."""
        _require_damping(self.loss_factor)
        object.__setattr__(self, "matrix", _positive_definite("matrix", self.matrix, (1, 2, 3, 4, 5, 6)))
        if self.law is not None and not np.array_equal(self.matrix, self.matrix[0, 0] * np.eye(3)):
            raise InvalidValueError(
                "law", problem="needs a stiffness alike in x, y and z", expected="k times the 3 x 3 identity"
            )


Spring: TypeAlias = JointSpring | AxialSpring | CantileverSpring | BeamSpring | ClosureSpring


class _Entry(Schema):
    makes: ClassVar[type[Spring]]
    name: Name


class _Joint(_Entry):
    makes = JointSpring
    type: Literal["joint"]
    joint: Name
    stiffness: Stiffness
    unit: JointSpringUnit
    loss_factor: float | None = None
    damping: float | None = None
    law: ContactLaw | None = None


class _Axial(_Entry):
    makes = AxialSpring
    type: Literal["axial"]
    at: Name
    axis: tuple[float, float, float]
    stiffness: Stiffness
    unit: Literal["N/m"]
    loss_factor: float | None = None
    law: ContactLaw | None = None


class _Cantilever(_Entry):
    makes = CantileverSpring
    type: Literal["cantilever"]
    at: Name
    axis: tuple[float, float, float]
    bending_stiffness: Stiffness
    torsional_stiffness: Stiffness
    length: PositiveLength | JointLength
    unit: Literal["N m^2"]
    axial_stiffness: Stiffness | None = None
    elements: int = 1
    shear_stiffness: Stiffness | Literal["rigid"] | None = None
    mass: float = 0.0
    loss_factor: float | None = None
    thickness: PositiveLength | None = None
    mass_model: MassModel = "consistent"


class _Beam(_Entry):
    makes = BeamSpring
    type: Literal["beam"]
    at: Name
    matrix: list[list[float]]
    loss_factor: float | None = None


class _Closure(_Entry):
    makes = ClosureSpring
    type: Literal["closure"]
    closure: Annotated[int, msgspec.Meta(ge=0)]
    matrix: list[list[float]]
    loss_factor: float | None = None
    law: ContactLaw | None = None


SPRING_SCHEMAS: dict[str, type[_Entry]] = {
    "joint": _Joint,
    "axial": _Axial,
    "cantilever": _Cantilever,
    "beam": _Beam,
    "closure": _Closure,
}
"""The schemas of an entry of `springs`, by type."""


def read_springs(
    entries: Iterable[Mapping[str, Any]], source: Path | str, least_positions: Mapping[str, float] | None = None
) -> tuple[Spring, ...]:
    """Read the `springs` of a closures file. Whether the joints and frames exist is checked by the mechanism.

    Beams whose length a joint changes are stubby if they are so at its least position, by joint, or else at its zero.

    Raises:
        DescriptionError: an entry has no name or a duplicate one, an unknown type, a missing or unknown key, a wrong
            unit, a number that is not finite and positive, or a matrix that is not symmetric and positive definite.
    """
    springs: list[Spring] = []
    for index, entry in enumerate(entries):
        element = f"springs[{index}]"
        name, kind = checked(entry.get("name"), Name, source, f"{element}.name"), entry.get("type")
        if name in {other.name for other in springs}:
            raise DescriptionError(source, element, f"duplicate name '{name}', expected unique names")
        element += f" '{name}'"
        if not isinstance(kind, str) or kind not in SPRING_SCHEMAS:
            raise DescriptionError(
                source, f"{element}.type", f"expected one of {', '.join(SPRING_SCHEMAS)}, not {kind}"
            )
        try:
            form = checked(with_contact(entry, source, element), SPRING_SCHEMAS[kind], source, element)
            values = {field.name: getattr(form, field.name) for field in fields(form.makes)}
            is_rigid = values.get("shear_stiffness") == RIGID
            spring = form.makes(**values | ({"shear_stiffness": None} if is_rigid else {}))
            springs.append(spring if is_rigid else _with_shear(spring, source, least_positions or {}))
        except InvalidValueError as error:
            place = f"{element}.{error.name}"
            raise DescriptionError(source, place, f"is {error.value}, expected {error.expected}") from error
    return tuple(springs)


def _with_shear(spring: Spring, source: Path | str, least_positions: Mapping[str, float]) -> Spring:
    """Return a stubby beam of known section with the shear of a round bar, if its file does not say."""
    if not isinstance(spring, CantileverSpring) or spring.shear_stiffness is not None:
        return spring
    length, words = spring.length, ""
    if isinstance(length, JointLength):
        shortest = length.at_zero + least_positions.get(length.joint, 0.0)
        length, words = shortest if shortest > 0.0 else length.at_zero, " at its shortest"
    shear = spring.estimated_shear_stiffness
    if shear is None or length <= 0.0 or (share := spring.shear_share(length)) < STUBBY:
        return spring
    _log.warning(
        "%s: spring '%s' is %.3g m long%s, and shear adds %.0f %% to its lateral give. Taken: shear_stiffness %.4g N, "
        "of a round bar; declare your own, or rigid",
        *(source, spring.name, length, words, 100.0 * share, shear),
    )
    return replace(spring, shear_stiffness=shear)


def with_contact(entry: Mapping[str, Any], source: Path | str, element: str) -> dict[str, Any]:
    """Return an entry with the stiffness and the law of the contact of the catalogue that it names, as plain data.

    Raises:
        DescriptionError: there is no such contact, or the entry has a stiffness or law beside it.
    """
    own = dict(entry)
    if (name := own.pop("contact", None)) is None:
        return own
    known = contacts()
    if not isinstance(name, str) or name not in known:
        raise DescriptionError(source, f"{element}.contact", f"is {name}, expected one of {', '.join(known)}")
    if clash := sorted({"law", "stiffness", "matrix"} & set(own)):
        raise DescriptionError(source, f"{element}.{clash[0]}", "expected none beside a contact of the catalogue")
    given = {key: own.pop(key) for key in ("preload", "play") if key in own}
    amounts = checked(given, dict[str, Positive], source, element)
    stiffness, law = known[name].spring(preload=amounts.get("preload"), play=amounts.get("play"))
    if own.get("type") == "closure":
        own["matrix"] = (stiffness * np.eye(3)).tolist()
    else:
        own |= {"stiffness": stiffness, "unit": "N/m"}
    return own | {"law": {key: value for key, value in msgspec.to_builtins(law).items() if value is not None}}


def _require_positive(name: str, value: float) -> None:
    if not STIFFNESS.least <= value <= STIFFNESS.greatest:
        raise InvalidValueError(name, value, f"a number from {STIFFNESS.least:g} to {STIFFNESS.greatest:g}")


def _require_damping(loss_factor: float | None, damping: float | None = None) -> None:
    for name, value in (("loss_factor", loss_factor), ("damping", damping)):
        if value is not None and not 0.0 <= value < np.inf:
            raise InvalidValueError(name, value, "a finite number, not negative")


def _unit_vector(axis: ArrayLike) -> tuple[float, float, float]:
    vector = np.asarray(axis, dtype=float)
    length = np.linalg.norm(vector) if vector.shape == (3,) else np.nan
    if not (np.isfinite(length) and length > 0.0):
        raise InvalidValueError("axis", axis, "three finite numbers, not all zero")
    x, y, z = (float(component) for component in vector / length)
    return x, y, z


def _positive_definite(name: str, matrix: ArrayLike, sizes: tuple[int, ...]) -> Matrix:
    """Return a read-only, exactly symmetric copy. Checked after scaling to a unit diagonal, since units are mixed."""
    array = finite_array(name, matrix, *((size, size) for size in sizes))
    diagonal = array.diagonal()
    if (diagonal < STIFFNESS.least).any() or (np.abs(array) > STIFFNESS.greatest).any():
        expected = f"numbers and a diagonal from {STIFFNESS.least:g} to {STIFFNESS.greatest:g}"
        raise InvalidValueError(name, array.tolist(), expected)
    scale = np.sqrt(diagonal)
    scaled = array / np.outer(scale, scale)
    if np.abs(scaled - scaled.T).max() > SOLVED:
        raise InvalidValueError(name, array.tolist(), "a symmetric matrix")
    if np.linalg.eigvalsh(scaled)[0] < ROUNDING:
        raise InvalidValueError(name, array.tolist(), "a positive definite matrix")
    symmetric: Matrix = 0.5 * (array + array.T)
    symmetric.setflags(write=False)
    return symmetric
