"""Design derivatives: derivatives of C with respect to lengths, angles and spring constants."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from numpy.typing import ArrayLike

from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array

DESIGN_PARAMETERS = (
    "base_radius",
    "platform_radius",
    "link_length",
    "guide_slope",
    "guide_heading",
    "platform_joint_height",
    "clamp_depth_ratio",
    "actuator_stiffness",
    "link_stiffness",
    "bending_stiffness",
    "torsional_stiffness",
)
_STEP = 3e-4  # relative to the parameter; the error of the formula is of fourth order in it


def design_derivatives(
    tripod: Tripod, poses: ArrayLike, parameters: Iterable[str] = DESIGN_PARAMETERS
) -> dict[str, Array]:
    """Return dC/dp at fixed poses for :data:`DESIGN_PARAMETERS` p, by name, shape=(..., 6, 6) [unit of C / of p].

    dC/dp = -C (dK/dp) C, with dK/dp by fourth-order central differences of the closed form, which agree with complex
    steps to 5e-8 C / p. A change of geometry shifts the heights of the level platform and with them the clamp of the
    passive leg. Poses are (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].

    Raises:
        InvalidValueError: an unknown parameter.
        UnreachablePoseError: a pose is out of reach, or becomes so after a step of the parameter.
    """
    pose_array = tripod.checked(poses)
    tool = inverse_definite(elastic_stiffness(tripod, pose_array))
    derivatives = {}
    for name in parameters:
        if name not in DESIGN_PARAMETERS:
            raise InvalidValueError("parameter", name, f"one of {', '.join(DESIGN_PARAMETERS)}")
        derivatives[name] = -tool @ _stiffness_derivative(tripod, pose_array, name) @ tool
    return derivatives


def _stiffness_derivative(tripod: Tripod, poses: Array, name: str) -> Array:
    value = getattr(tripod.parameters, name)
    step = _STEP * (abs(value) or 1.0)

    def moved(steps: float) -> Array:
        changed = dataclasses.replace(tripod.parameters, **{name: value + steps * step})
        return elastic_stiffness(Tripod(changed), poses)

    derivative: Array = (8.0 * (moved(1.0) - moved(-1.0)) - (moved(2.0) - moved(-2.0))) / (12.0 * step)
    return derivative
