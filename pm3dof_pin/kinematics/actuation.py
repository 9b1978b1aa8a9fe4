"""The platform's independent motions, and drives that can move independently."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import frozen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE, DegreesOfFreedom, RankDecision, Restriction
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.tolerances import RANK_GAP
from pm3dof_pin.typing import Matrix, Vector

_PIVOT_DIGITS = 9


def motion_components(configuration: Configuration) -> tuple[ToolComponent, ...]:
    """Choose components of the tool's twist, world axes, that describe its independent motions: one per motion.

    If every motion turns the tool about an axis within the machine, as in a wrist, these are rotations. Otherwise they
    are the most independent of the `tool_motions`, in scaled numbers: x, y and rz for a planar platform, z, rx and ry
    for a 3-RPS platform.

    Raises:
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    dof = DegreesOfFreedom(configuration)
    seen = dof.at_tool
    counting = [TOOL_COMPONENTS.index(name) for name in configuration.mechanism.tool_motions]
    if _turns_within(configuration, dof):
        seen = dof.over(dof.twist[3:])
        counting = [3, 4, 5]
    return tuple(TOOL_COMPONENTS[counting[row]] for row in _most_independent(seen.image))


def independent_drives(configuration: Configuration) -> list[int]:
    """Choose actuated joints, by index, that can move independently: the most independent ones in scaled numbers.

    All of them, unless there are more than degrees of freedom or the pose is singular. InvalidValueError if the loops
    are not closed.
    """
    return _most_independent(DegreesOfFreedom(configuration).at_actuators.image)


def motions_of_drives(configuration: Configuration) -> tuple[int, int]:
    """Count the motions of drives and tool together, and how many of them the drives tell apart.

    The drives' rates in scaled numbers, a row of length one for each drive, so that gears do not matter, tell as many
    apart as they have singular values above the greatest over :data:`~pm3dof_pin.tolerances.RANK_GAP`.

    Raises:
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    dof = DegreesOfFreedom(configuration)
    rates = dof.actuators @ dof.basis
    sizes = np.linalg.norm(rates, axis=1, keepdims=True)
    scaled = rates / np.where(sizes > RANK_TOLERANCE, sizes, 1.0)
    values: Vector = np.asarray(np.linalg.svd(scaled, compute_uv=False), dtype=np.float64)
    told = RankDecision.from_singular_values(values, float(values.max(initial=0.0)) / RANK_GAP)
    return dof.idle.rank.rank, told.rank


def independent_motions(configuration: Configuration, *, components: Sequence[ToolComponent] = ()) -> Matrix:
    """Compute the joint velocities of the platform's independent motions, shape=(nv, p).

    Column k is the velocity at which motion k has rate 1 and the others 0. The motions are the given `components` of
    the tool's twist, world axes; by default the motion coordinates, if the mechanism has any, or else the
    :func:`motion_components`. If idle degrees of freedom leave a choice, the velocity has the least norm in scaled
    numbers.

    Raises:
        SingularConfigurationError: the motions are not independent, or actuated joints or the tool can move without
            them.
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    dof = DegreesOfFreedom(configuration)
    mechanism = configuration.mechanism
    if components or not mechanism.motion_coordinates:
        names: Sequence[str] = components or motion_components(configuration)
        rows = [TOOL_COMPONENTS.index(name) for name in names]
        driven, scale = dof.over(dof.twist[rows]), dof.twist_scale[rows]
    else:
        names = mechanism.motion_coordinates
        indices = mechanism.velocity_indices(names)
        driven, scale = dof.over(np.eye(len(dof.scale))[indices]), dof.scale[indices]
    motions = f"the motions {', '.join(names)} are"
    if driven.rank.rank < len(names):
        values = driven.rank.singular_values
        raise SingularConfigurationError(f"{motions} not independent at {configuration}: singular values {values}")
    if Restriction(dof.actuators_and_tool, driven.motions).rank.rank > 0:
        raise SingularConfigurationError(
            f"actuated joints or the tool can move at {configuration} while {motions} at rest"
        )
    return frozen(dof.scale[:, None] * driven.inverse / scale)


def tool_motions(configuration: Configuration, *, components: Sequence[ToolComponent] = ()) -> Matrix:
    """Compute the tool's twists [v; omega], world axes, shape=(6, p), in the platform's :func:`independent_motions`.

    The tool's twist is this times the rates of the motions. Arguments and errors as in :func:`independent_motions`.
    """
    motions = independent_motions(configuration, components=components)
    return frozen(configuration.tool_jacobian @ motions)


def _most_independent(image: Matrix) -> list[int]:
    """Return the indices of the most independent rows, as many as columns, of an image with orthonormal columns."""
    from scipy.linalg import qr  # most robots declare their coordinates

    # rounded, so that the choice among equally good ones does not depend on the last digits
    projector = np.round(image @ image.T, _PIVOT_DIGITS)
    return sorted(int(row) for row in qr(projector, mode="r", pivoting=True)[1][: image.shape[1]])


def _turns_within(configuration: Configuration, dof: DegreesOfFreedom) -> bool:
    """Return whether all motions turn the tool, about axes no further from it than the farthest joint."""
    mechanism = configuration.mechanism
    if mechanism.tool_motions != TOOL_COMPONENTS or dof.at_tool.rank.rank == 0:
        return False
    linear, angular = np.split(dof.twist_scale[:, None] * dof.at_tool.image, 2)
    if Restriction(angular, np.eye(angular.shape[1])).rank.rank < angular.shape[1]:
        return False
    model = mechanism.model
    data = model.createData()
    pin.forwardKinematics(model, data, configuration.q)
    joints = np.array([data.oMi[index].translation for index in range(1, model.njoints)])
    farthest = np.linalg.norm(joints - configuration.tool_placement.translation, axis=1).max()
    return bool(np.linalg.norm(linear @ np.linalg.pinv(angular), 2) <= farthest * (1.0 + RANK_TOLERANCE))
