"""The p x p stiffness of a mechanism's free motions, for which no 6 x 6 stiffness may exist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, ToolComponent, Unit, unit_of
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.actuation import motion_components, tool_motions
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.tool_components import angle_rates, tool_components
from pm3dof_pin.typing import Matrix


@dataclass(frozen=True, eq=False)
class FreeMotionStiffness:
    """The stiffness of a mechanism's independent motions, with all other directions held."""

    #: the motions: the robot's declared coordinates; or components x, y, z, rx, ry, rz of the tool's twist, world axes
    names: tuple[str, ...]
    units: tuple[Unit, ...]  #: "m" or "rad" for each
    components: tuple[ToolComponent, ...]  #: the names, if the motions are components of the twist; otherwise empty
    twists: Matrix  #: the tool's twist [v; omega] at unit rates of the motions, world axes, shape=(6, p)
    stiffness: Matrix  #: symmetric, shape=(p, p) [N/m, N, N m/rad]


def free_motion_stiffness(
    model: ElasticModel, configuration: Configuration, *, components: Sequence[ToolComponent] = ()
) -> FreeMotionStiffness:
    """Compute the stiffness of the free motions of a mechanism, K = J^T k J with springs k at the drives.

    The motions are those of the coordinates declared by the description, if there is one for each of the tool's
    degrees of freedom; otherwise components of the tool's twist, on which the others depend.

    Example:
        >>> import pm3dof_pin as pm
        >>> model = pm.ElasticModel.load("three_rps")
        >>> free = pm.free_motion_stiffness(model, model.rigid.home)
        >>> free.names, free.stiffness.shape
        (('z', 'rx', 'ry'), (3, 3))

    Args:
        model: the mechanism with its springs.
        configuration: an assembled configuration of the rigid mechanism.
        components: the components of the tool's twist to use as motions; by default chosen by
            :func:`~pm3dof_pin.kinematics.actuation.motion_components`.

    Raises:
        SingularConfigurationError: the motions are not independent, the tool can move without them, or it is free or
            rigid in a direction, which the message names.
        DescriptionError: the robot has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    require_kind("model", model, ElasticModel, "pm.ElasticModel.load")
    require_kind("configuration", configuration, Configuration, "Poses.configuration")
    tool = cartesian_compliance(model, configuration)
    coordinates = configuration.mechanism.declared_coordinates
    dof = DegreesOfFreedom(configuration)
    if len(coordinates) == dof.at_tool.rank.rank and not components:
        chosen: tuple[ToolComponent, ...] = ()
        names, units = tuple(c.name for c in coordinates), tuple(c.unit for c in coordinates)
        twists = _coordinate_twists(configuration, dof, coordinates)
    else:
        chosen = tuple(components) or motion_components(configuration)
        names, units = chosen, tuple(unit_of(component) for component in chosen)
        twists = tool_motions(configuration, components=chosen)
    return FreeMotionStiffness(names, units, chosen, frozen(twists), tool.stiffness_over(twists))


def _coordinate_twists(
    configuration: Configuration, dof: DegreesOfFreedom, coordinates: tuple[Coordinate, ...]
) -> Matrix:
    """Return the tool's twists at unit rates of coordinates, shape=(6, p)."""
    jacobian, nv = configuration.tool_jacobian, configuration.mechanism.model.nv
    angles = tool_components(configuration.tool_placement.homogeneous)[3:]
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
