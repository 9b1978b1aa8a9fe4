"""The tripod's parameters: one YAML file read into typed, checked SI numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np

from pm3dof_pin.description.inertia_checks import inertia_problem
from pm3dof_pin.description.physical_bounds import ANGLE, ANY, LENGTH, MASS, MOMENT, NOT_NEGATIVE, STIFFNESS
from pm3dof_pin.description.robots import DESCRIPTION_SUFFIX, robot_names, robots_directory
from pm3dof_pin.description.schema import Name, checked
from pm3dof_pin.description.yaml_file import merged, read_mapping
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.typing import Vector

Unit: TypeAlias = Literal[
    "1", "m", "kg", "kg m^2", "rad", "m/s", "rad/s", "N", "N m", "N/m", "N m/rad", "N m^2", "Pa", "kg/m^3", "mm", "deg"
]

ON_PLATFORM = "platform"
"""Location of the universal joint of the passive leg in the chapter's machine."""

_TO_SI: dict[str, Callable[[float], float]] = {
    # decimal arithmetic, so that 240.272 mm is exactly the double nearest to 0.240272 m
    "mm": lambda number: float(Decimal(repr(number)).scaleb(-3)),
    "deg": math.radians,
}


_BOUNDS = {
    "m": LENGTH,
    "mm": LENGTH,
    "rad": ANGLE,
    "deg": ANGLE,
    "kg": MASS,
    "kg m^2": MOMENT,
    "N/m": STIFFNESS,
    "N m/rad": STIFFNESS,
    "N m^2": STIFFNESS,
    "Pa": STIFFNESS,
    "kg/m^3": NOT_NEGATIVE,
}


class Parameter(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One entry of the YAML file: a number or numbers in `unit`, with their origin."""

    value: float | tuple[float, ...]
    unit: Unit
    status: Literal["printed", "inferred", "chosen"]
    source: str  #: table, equation or rationale
    symbol: str = "none"  #: the chapter's symbol

    @property
    def si(self) -> float | tuple[float, ...]:
        """The value in SI units and radians."""
        convert = _TO_SI.get(self.unit, float)
        return tuple(map(convert, self.value)) if isinstance(self.value, tuple) else convert(self.value)


@dataclass(frozen=True)
class RoundSection:
    """A round bar or tube [m], relative to the solid bar of `reference_radius` whose stiffness and mass are known.

    Raises:
        InvalidValueError: the radius is not greater than the bore, or a radius is not positive.
    """

    radius: float
    bore: float
    reference_radius: float

    def __post_init__(self) -> None:
        """Check the radii."""
        if not (0.0 <= self.bore < self.radius < math.inf and 0.0 < self.reference_radius < math.inf):
            raise InvalidValueError("radius", self.radius, f"a finite radius greater than the bore of {self.bore:g} m")

    @property
    def area(self) -> float:
        """Area of the section [m^2]."""
        return math.pi * (self.radius**2 - self.bore**2)

    @property
    def second_moment(self) -> float:
        """Second moment of area about a diameter, half the polar moment [m^4]."""
        return 0.25 * math.pi * (self.radius**4 - self.bore**4)

    @property
    def area_ratio(self) -> float:
        """Area relative to the reference, to which the mass is proportional."""
        return self._ratio(2)

    @property
    def moment_ratio(self) -> float:
        """Second moment relative to the reference, to which E I and G J are proportional."""
        return self._ratio(4)

    def _ratio(self, power: int) -> float:
        return float((self.radius / self.reference_radius) ** power - (self.bore / self.reference_radius) ** power)


@dataclass(frozen=True, eq=False)
class TripodParameters:
    """Parameters of a tripod with n actuated PUS legs and a passive PU leg, in SI units.

    Geometry and symbols: D. Zhang, Parallel Robotic Machine Tools (Springer 2010), Fig. 8.1, Tables 8.1 and 8.2.
    """

    name: str  #: name of the machine
    base_joint_angles: Vector  #: alpha_i, direction of B_i about z, shape=(n,) [rad]
    platform_joint_angles: Vector  #: beta_i, direction of E_i about the platform's z, shape=(n,) [rad]
    base_radius: float  #: l_b, radius of B_i [m]
    platform_radius: float  #: l_e, radius of E_i [m]
    link_length: float  #: l, length of each link [m]
    guide_slope: float  #: gamma, slope of the guideways relative to the base plane [rad]
    guide_heading: float  #: direction of a guideway in plan, measured from the outward radius [rad]
    platform_joint_height: float  #: z_0, height of E_i above O_e in the platform frame [m]
    clamp_depth_ratio: float  #: (z_min - z_b) / (z_max - z_min), which places the clamp of the passive leg
    slider_home: float  #: middle of the slider's travel along the guideway from B_i [m]
    slider_stroke: float  #: travel to either side of the middle [m]
    spherical_limit: float  #: maximum angle between a link and its spherical joint's axis [rad]
    spherical_axis_inclination: float  #: inclination of that axis from the platform's normal towards its centre [rad]
    universal_limit: float  #: maximum angle about each axis of a universal joint, to either side [rad]
    #: stops of the passive prismatic joint beyond z_min, z_max, as a ratio of z_max - z_min
    passive_slider_margin: float
    actuator_stiffness: float  #: k_a along the guideway [N/m]
    link_stiffness: float  #: k_t along the link [N/m]
    bending_stiffness: float  #: E I of the passive leg's section [N m^2]
    torsional_stiffness: float  #: G J of the passive leg's section [N m^2]
    platform_mass: float  #: [kg], as the next three
    link_mass: float
    slider_mass: float
    passive_leg_mass: float
    passive_leg: RoundSection  #: section of the passive leg
    cross_mass: float  #: of a universal joint [kg]
    platform_moments: Vector  #: principal moments of inertia, shape=(3,) [kg m^2], as the next
    link_moments: Vector
    tilt_range: Vector  #: printed working range of theta_x and theta_y, shape=(2,) [rad]
    height_range: Vector  #: printed working range of z_e, shape=(2,) [m]
    quantities: Mapping[str, Parameter]  #: every entry of the file with its unit, status and source, by "section.key"

    @property
    def youngs_modulus(self) -> float:
        """E implied by the bending stiffness and section of the passive leg [Pa]."""
        return self.bending_stiffness / self.passive_leg.second_moment

    @property
    def axial_stiffness(self) -> float:
        """E A of the passive leg, which carries no axial load: it slides along its axis [N]."""
        return self.youngs_modulus * self.passive_leg.area

    @property
    def leg_count(self) -> int:
        """Number of actuated legs, n."""
        return len(self.base_joint_angles)

    @classmethod
    def load(cls, path: Path | str | None = None) -> TripodParameters:
        """Read the parameters of a tripod from a file like `robots/pm3dof_description/config/pm3dof.yaml`, the default.

        Raises:
            DescriptionError: a number is missing, not finite, or has an unknown unit or a wrong sign or length.
        """
        path = Path(path) if path is not None else _default_parameters_path()
        sections = read_parameters(path)
        if sections.get("universal_joint", ON_PLATFORM) != ON_PLATFORM:
            expected = f"expected {ON_PLATFORM}: the closed form is for the chapter's machine"
            raise DescriptionError(path, "universal_joint", expected)
        reader = _Reader(path, _quantities(path, sections))
        alpha = reader.vector("geometry.base_joint_angles")
        platform_mass, link_mass = (reader.positive(f"inertia.{body}_mass") for body in ("platform", "link"))
        tilt_range, height_range = (reader.interval(f"printed_working_range.{key}") for key in ("tilt", "height"))
        bar = _section(reader)
        return cls(
            name=checked(sections.get("name"), Name, path, "name"),
            base_joint_angles=alpha,
            platform_joint_angles=reader.vector("geometry.platform_joint_angles", len(alpha)),
            base_radius=reader.positive("geometry.base_radius"),
            platform_radius=reader.positive("geometry.platform_radius"),
            link_length=reader.positive("geometry.link_length"),
            guide_slope=reader.number("geometry.guide_slope"),
            guide_heading=reader.number("geometry.guide_heading"),
            platform_joint_height=reader.number("geometry.platform_joint_height"),
            clamp_depth_ratio=reader.positive("geometry.clamp_depth_ratio"),
            slider_home=reader.number("joints.slider_home"),
            slider_stroke=reader.positive("joints.slider_stroke"),
            spherical_limit=reader.positive("joints.spherical_limit"),
            spherical_axis_inclination=reader.number("joints.spherical_axis_inclination"),
            universal_limit=reader.positive("joints.universal_limit"),
            passive_slider_margin=reader.positive("joints.passive_slider_margin"),
            actuator_stiffness=reader.positive("stiffness.actuator"),
            link_stiffness=reader.positive("stiffness.link"),
            bending_stiffness=reader.positive("stiffness.passive_leg_bending") * bar.moment_ratio,
            torsional_stiffness=reader.positive("stiffness.passive_leg_torsion") * bar.moment_ratio,
            platform_mass=platform_mass,
            link_mass=link_mass,
            slider_mass=reader.positive("inertia.slider_mass"),
            passive_leg_mass=reader.positive("inertia.passive_leg_mass") * bar.area_ratio,
            passive_leg=bar,
            cross_mass=reader.positive("inertia.cross_mass"),
            platform_moments=reader.moments("inertia.platform_moments", platform_mass),
            link_moments=reader.moments("inertia.link_moments", link_mass),
            tilt_range=tilt_range,
            height_range=height_range,
            quantities=reader.quantities,
        )


def _default_parameters_path() -> Path:
    """Return the path of the chapter machine's parameters."""
    return robots_directory() / "pm3dof_description" / "config" / "pm3dof.yaml"


def read_parameters(path: Path | str) -> dict[str, Any]:
    """Read a parameter file; one that `extends` another contains only the differences.

    `extends` is the name of a robot of the package, or a path relative to the file's folder. Entries replace those of
    the other file key by key: `section: {passive_leg_radius: {value: 10.0}}` changes a radius.

    Raises:
        DescriptionError: a file is missing, is not YAML or not a mapping, or extends itself.
    """
    return _extended(Path(path), ())


def _extended(path: Path, before: tuple[Path, ...]) -> dict[str, Any]:
    sections = read_mapping(path)
    other = sections.pop("extends", None)
    if other is None:
        return sections
    if not isinstance(other, str):
        raise DescriptionError(path, "extends", f"expected the name of a robot or a path, not {other}")
    base = path.parent / other
    if other in robot_names():
        base = robots_directory() / f"{other}{DESCRIPTION_SUFFIX}" / "config" / f"{other}.yaml"
    if base.resolve() in (*before, path.resolve()):
        raise DescriptionError(path, "extends", f"expected another file, not {other}, which leads back here")
    return merged(_extended(base, (*before, path.resolve())), sections)


def find_parameters(robot: str, name: Path | str) -> Path:
    """Return a parameter file given by path, or by name if it comes with a robot, such as universal_joint_at_base."""
    own = robots_directory() / f"{robot}{DESCRIPTION_SUFFIX}" / "config" / f"{name}.yaml"
    return own if not Path(name).exists() and own.is_file() else Path(name)


def read_quantities(path: Path | str) -> dict[str, Parameter]:
    """Read all quantities of a robot's parameter file, keyed "section.name"; DescriptionError for a bad entry."""
    path = Path(path)
    return _quantities(path, read_parameters(path))


def _quantities(path: Path, sections: Mapping[str, Any]) -> dict[str, Parameter]:
    """All quantities of a parameter file, keyed "section.name"."""
    return {
        (key := f"{section}.{name}"): _quantity(path, key, entry)
        for section, entries in sections.items()
        if isinstance(entries, dict)
        for name, entry in entries.items()
    }


def _quantity(path: Path, key: str, entry: object) -> Parameter:
    quantity = checked(entry, Parameter, path, key)
    bounds = _BOUNDS.get(quantity.unit, ANY)
    for number in np.atleast_1d(quantity.si):
        if problem := bounds.problem(float(number)):
            raise DescriptionError(path, f"{key}.value", problem)
    return quantity


def _section(reader: _Reader) -> RoundSection:
    """Return the section of the passive leg; by default the one with the printed stiffness and mass."""
    keys = [f"section.passive_leg_{name}" for name in ("radius", "bore", "reference_radius")]
    if keys[0] not in reader.quantities:
        drawn = reader.positive("drawing.passive_leg_radius")
        return RoundSection(drawn, 0.0, drawn)
    try:
        return RoundSection(*map(reader.number, keys))
    except InvalidValueError as error:
        raise DescriptionError(reader.path, "section", f"expected {error.expected}") from error


class _Reader:
    """Takes SI numbers from the quantities of one file; errors name the file."""

    def __init__(self, path: Path, quantities: Mapping[str, Parameter]) -> None:
        self.path = path
        self.quantities = quantities

    def number(self, key: str) -> float:
        value = self._si(key)
        if isinstance(value, tuple):
            raise DescriptionError(self.path, f"{key}.value", "expected one number, not a list")
        return value

    def positive(self, key: str) -> float:
        value = self.number(key)
        if value <= 0.0:
            raise DescriptionError(self.path, f"{key}.value", f"{value} is not positive")
        return value

    def vector(self, key: str, length: int | None = None) -> Vector:
        value = self._si(key)
        if not isinstance(value, tuple) or (length is not None and len(value) != length):
            raise DescriptionError(self.path, f"{key}.value", f"expected a list of {length or 'several'} numbers")
        vector = np.array(value)
        vector.setflags(write=False)
        return vector

    def moments(self, key: str, mass: float) -> Vector:
        vector = self.vector(key, 3)
        if (vector < 0.0).any() or (problem := inertia_problem(mass, np.diag(vector))):
            problem = "expected nonnegative moments" if (vector < 0.0).any() else problem
            raise DescriptionError(self.path, f"{key}.value", problem)
        return vector

    def interval(self, key: str) -> Vector:
        vector = self.vector(key, 2)
        if not vector[0] < vector[1]:
            raise DescriptionError(self.path, f"{key}.value", f"expected [lower, upper], not {vector.tolist()}")
        return vector

    def _si(self, key: str) -> float | tuple[float, ...]:
        if key not in self.quantities:
            raise DescriptionError(self.path, key, "is missing; expected value, unit, status and source")
        return self.quantities[key].si
