"""The stiffness of the motions that a mechanism is free to make: p x p, where no 6 x 6 stiffness exists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, Unit
from pm3dof_pin.elastic.condensation import condensed
from pm3dof_pin.elastic.directions import direction_names
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.actuation import tool_motions
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.tool_angles import angle_rates, angles_of_rotation
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix

_NO_PART = 1e-9
_UNITS: tuple[Unit, Unit] = ("m", "rad")


@dataclass(frozen=True, eq=False)
class FreeMotionStiffness:
    """The stiffness of a mechanism's independent motions, the directions that it cannot move in being held."""

    #: the motions: the robot's coordinates; or x, y, z, rx, ry, rz of the tool's twist, or a twist in words
    names: tuple[str, ...]
    units: tuple[Unit, ...]  #: "m" or "rad" of each
    twists: Matrix  #: the tool's twist [v; omega] at unit rates of the motions, world axes, shape=(6, p)
    stiffness: Matrix  #: symmetric, shape=(p, p) [N/m, N, N m/rad]


def free_motion_stiffness(model: ElasticModel, configuration: Configuration) -> FreeMotionStiffness:
    """Compute the stiffness of the motions that a mechanism is free to make, K = J^T k J with springs k at the drives.

    The motions are those of the coordinates that the description declares, if there is one for each of the tool's
    degrees of freedom; else unit twists of the tool along and about the axes of the base, as far as they span them.

    Example:
        >>> import pm3dof_pin as pm
        >>> model = pm.ElasticModel.load("three_rps")
        >>> free = pm.free_motion_stiffness(model, model.rigid.home)
        >>> free.names, free.stiffness.shape
        (('z', 'rx', 'ry'), (3, 3))

    Args:
        model: the mechanism with its springs.
        configuration: an assembled configuration of the rigid mechanism.

    Raises:
        SingularConfigurationError: the motions are not independent there, or the tool moves without them; or it is free
            or rigid in a direction, which the message names.
        DescriptionError: the robot has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    tool = condensed(model, configuration)
    coordinates = configuration.mechanism.declared_coordinates
    dof = DegreesOfFreedom(configuration)
    if len(coordinates) == dof.at_tool.rank.rank:
        names, units = tuple(c.name for c in coordinates), tuple(c.unit for c in coordinates)
        twists = _coordinate_twists(configuration, dof, coordinates)
    else:
        twists = tool_motions(configuration)
        turns = np.abs(twists[3:]).max(axis=0) > _NO_PART
        twists = twists / np.where(turns, 1.0, np.linalg.norm(twists[:3], axis=0))
        names = tuple(_name(twist) for twist in twists.T)
        units = tuple(_UNITS[bool(turn)] for turn in turns)
    return FreeMotionStiffness(names, units, frozen(twists), tool.stiffness_over(twists))


def _coordinate_twists(
    configuration: Configuration, dof: DegreesOfFreedom, coordinates: tuple[Coordinate, ...]
) -> Matrix:
    """Return the tool's twists at unit rates of coordinates, shape=(6, p)."""
    jacobian, nv = configuration.tool_jacobian, configuration.mechanism.model.nv
    angles = angles_of_rotation(configuration.tool_placement.rotation)
    components = np.vstack([jacobian[:3], angle_rates(angles) @ jacobian[3:]])
    rows = np.zeros((len(coordinates), nv))
    for row, coordinate in zip(rows, coordinates, strict=True):
        if coordinate.joint is not None:
            row[configuration.mechanism.single_joint(coordinate.joint).v_index] = coordinate.scale
        elif coordinate.tool is not None:
            row[:] = components[TOOL_COMPONENTS.index(coordinate.tool)]
    length = configuration.mechanism.characteristic_length
    scale = np.array([length if coordinate.unit == "m" else 1.0 for coordinate in coordinates])
    driven = dof.over(rows * dof.scale / scale[:, None])
    if driven.rank.rank < len(coordinates):
        names = ", ".join(coordinate.name for coordinate in coordinates)
        raise SingularConfigurationError(f"the coordinates {names} are not independent at {configuration}")
    twists: Matrix = jacobian @ (dof.scale[:, None] * (driven.inverse / scale))
    return twists


def _name(twist: Matrix) -> str:
    parts = np.abs(twist) > _NO_PART
    return TOOL_COMPONENTS[int(parts.argmax())] if parts.sum() == 1 else direction_names(twist[:, None])
