"""What can be mapped over the workspace: named quantities of the tripod with their dimensions and units."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from pm3dof_pin.chapter import chapter_stiffness as chapter
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness, spring_contributions, spring_names
from pm3dof_pin.chapter.kinematics import inverse_kinematics
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.description.parameters import TripodParameters
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.elastic import indices, shares
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.typing import Array

AXES = ("x", "y", "z", "rx", "ry", "rz")

_MODES = 6


class Evaluation:
    """A tripod at a block of poses; what several quantities need is computed once.

    Args:
        tripod: the machine.
        poses: shape=(..., 3) [rad, rad, m]; poses out of reach give NaN.
    """

    def __init__(self, tripod: Tripod, poses: Array) -> None:
        self.tripod = tripod
        self.poses = poses

    @cached_property
    def stiffness(self) -> Array:
        """K at O_e, shape=(..., 6, 6)."""
        return elastic_stiffness(self.tripod, self.poses, on_failure="nan")

    @cached_property
    def compliance(self) -> Array:
        """C = K^-1, shape=(..., 6, 6)."""
        return indices.compliance(self.stiffness)

    @cached_property
    def chapter_diagonal(self) -> Array:
        """The chapter's six numbers, shape=(..., 6)."""
        return chapter.chapter_stiffness(self.tripod, self.poses, on_failure="nan")

    @cached_property
    def length(self) -> Array:
        """Characteristic length of K at each pose [m]."""
        return indices.characteristic_length(self.stiffness)

    def principal(self, motion: indices.Motion) -> Array:
        """Principal stiffnesses of three motions, the others free, shape=(..., 3)."""
        return indices.ellipsoid(indices.condensed_stiffness(self.compliance, motion)).values

    def shares(self) -> Array:
        """Share of each spring in the deflection under a unit wrench along each axis, shape=(..., 6, s)."""
        contributions = spring_contributions(self.tripod, self.poses)
        return shares.shares(contributions[..., None, :, :, :], np.eye(6))

    def natural_frequencies(self) -> Array:
        """Lowest natural frequencies with the drives held by their springs, shape=(..., 6) [Hz].

        Raises:
            InvalidValueError: the masses are not known: the tripod is not the one that comes with the package.
        """
        if self.tripod.parameters.quantities != TripodParameters.load().quantities:
            raise InvalidValueError(
                "natural_frequencies", f"of {self.tripod.parameters.name}", "the machine whose URDF has the masses"
            )
        model = _described_model(self.tripod.parameters.name)
        frequencies = np.full((*self.poses.shape[:-1], _MODES), np.nan)
        for index in np.ndindex(self.poses.shape[:-1]):
            try:
                pose = model.rigid.solve(self.poses[index])
            except UnreachablePoseError:
                continue
            frequencies[index] = natural_modes(model, pose.configuration(), count=_MODES).frequencies
        return frequencies


@cache
def _described_model(name: str) -> ElasticModel:
    return ElasticModel.load(name)


@dataclass(frozen=True)
class Quantity:
    """One quantity of a map.

    Attributes:
        name: its name.
        dims: its own dimensions beside those of the grid.
        unit: its unit; where the entries differ, the units in their order.
        long_name: what it is, for a person.
        compute: from an evaluation to an array, shape=(..., *own dimensions).
    """

    name: str
    dims: tuple[str, ...]
    unit: str
    long_name: str
    compute: Callable[[Evaluation], Array]


_MATRIX_UNIT = "N/m, N, N m/rad"
_AXIS_UNIT = "N/m (x, y, z), N m/rad (rx, ry, rz)"

_ALL = (
    Quantity(
        "K", ("axis", "axis_2"), _MATRIX_UNIT, "elastic stiffness at the tool, axes of the base", lambda e: e.stiffness
    ),
    Quantity("C", ("axis", "axis_2"), "m/N, 1/N, rad/(N m)", "elastic compliance at the tool", lambda e: e.compliance),
    Quantity(
        "felt_stiffness",
        ("axis",),
        _AXIS_UNIT,
        "stiffness felt along one axis, all other motions free",
        lambda e: 1.0 / np.einsum("...ii->...i", e.compliance),
    ),
    Quantity(
        "translational_stiffness",
        ("principal",),
        "N/m",
        "principal translational stiffnesses, rotations free",
        lambda e: e.principal("translation"),
    ),
    Quantity(
        "rotational_stiffness",
        ("principal",),
        "N m/rad",
        "principal rotational stiffnesses, translations free",
        lambda e: e.principal("rotation"),
    ),
    Quantity(
        "eigenvalues",
        ("mode",),
        "N/m",
        "eigenvalues of K at its characteristic length",
        lambda e: indices.eigenvalues(e.stiffness, e.length),
    ),
    Quantity(
        "condition_number",
        (),
        "1",
        "condition number of K at its characteristic length",
        lambda e: indices.condition_number(e.stiffness, e.length),
    ),
    Quantity(
        "characteristic_length", (), "m", "length that makes rotations as stiff as translations", lambda e: e.length
    ),
    Quantity("spring_shares", ("axis", "spring"), "1", "share of each spring in the deflection", lambda e: e.shares()),
    Quantity(
        "natural_frequencies",
        ("natural_mode",),
        "Hz",
        "lowest natural frequencies",
        lambda e: e.natural_frequencies(),
    ),
    Quantity(
        "chapter_diagonal",
        ("chapter_axis",),
        "N m/rad (theta_x, theta_y, theta_z), N/m (t_z, t_x, t_y)",
        "stiffness as the chapter computes it",
        lambda e: e.chapter_diagonal,
    ),
    Quantity(
        "chapter_global",
        (),
        "mixed",
        "mean of the chapter's six numbers",
        lambda e: chapter.global_index(e.chapter_diagonal),
    ),
    Quantity(
        "slider_travel",
        ("leg",),
        "m",
        "slider travel along the guideways",
        lambda e: inverse_kinematics(e.tripod, e.poses, on_failure="nan"),
    ),
)
QUANTITIES = {quantity.name: quantity for quantity in _ALL}


def select_quantities(names: Iterable[str]) -> tuple[Quantity, ...]:
    """Return the quantities of the given names, in that order, each once.

    Raises:
        InvalidValueError: a name that is not in :data:`QUANTITIES`, or none at all.
    """
    selected = tuple(dict.fromkeys(names))
    unknown = [name for name in selected if name not in QUANTITIES]
    if unknown or not selected:
        raise InvalidValueError("quantities", ", ".join(unknown) or "none", f"some of {', '.join(QUANTITIES)}")
    return tuple(QUANTITIES[name] for name in selected)


def labels(tripod: Tripod) -> dict[str, tuple[str, ...]]:
    """Return what the entries along each own dimension of the quantities are called."""
    return {
        "axis": AXES,
        "axis_2": AXES,
        "principal": ("least", "middle", "greatest"),
        "mode": tuple(str(mode) for mode in range(1, 7)),
        "spring": spring_names(tripod),
        "natural_mode": tuple(str(mode) for mode in range(1, _MODES + 1)),
        "chapter_axis": chapter.AXES,
        "leg": tuple(str(leg + 1) for leg in range(tripod.leg_count)),
    }
