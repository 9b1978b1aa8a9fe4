"""Holding forces, inertia and natural frequencies at many poses, by compiled programs, or pose by pose if in doubt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.arrays import require_kind
from pm3dof_pin.dynamics.mass_matrix import drive_mass_matrix
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.kinematics.pose_values import BatchOptions, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.tolerances import MASSLESS
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_PROGRAM_FROM = 500  # poses; for fewer, Pinocchio takes no longer than recording and compiling a program


class LoadedBatchOptions(BatchOptions, total=False):
    """Options of functions that evaluate many poses of a robot with payloads."""

    payloads: Payloads | None  #: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia`


def actuator_forces(robot: Robot, poses: Poses | ArrayLike, **options: Unpack[LoadedBatchOptions]) -> Array:
    """Compute the forces of the actuators that hold many poses against gravity and payloads.

    Example:
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.dynamics.batch import actuator_forces
        >>> robot = pm.load("pm3dof")
        >>> actuator_forces(robot, robot.solve(robot.grid(z_e=(0.45, 0.55, 3)))).round(3)[1]
        array([5.998, 5.998, 5.998])

    Args:
        robot: the robot.
        poses: solved poses, or configurations q with closed loops, shape=(..., nq) [m, rad].
        options: see :class:`LoadedBatchOptions` and :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Returns:
        Forces along the actuated joints, see :func:`~pm3dof_pin.dynamics.statics.holding_forces`,
        shape=(..., number of actuated joints) [N, N m].

    Raises:
        PM3DofError: as :func:`~pm3dof_pin.dynamics.statics.holding_forces`.
    """
    return _of_drives(
        robot, poses, "holding_forces", lambda q, p: holding_forces(q, payloads=p).actuator_forces, 1, **options
    )


def drive_mass_matrices(robot: Robot, poses: Poses | ArrayLike, **options: Unpack[LoadedBatchOptions]) -> Array:
    """Compute :func:`~pm3dof_pin.dynamics.mass_matrix.drive_mass_matrix` at many poses, shape=(..., u, u).

    Arguments and errors as in :func:`actuator_forces`.
    """
    require_kind("robot", robot, Robot, "pm.load")
    robot.require_possible_inertias()
    return _of_drives(robot, poses, "mass_matrix", lambda q, p: drive_mass_matrix(q, payloads=p), 2, **options)


def _of_drives(
    robot: Robot,
    poses: Poses | ArrayLike,
    name: Literal["holding_forces", "mass_matrix"],
    reference: Callable[[Configuration, Payloads | None], Array],
    order: int,
    *,
    payloads: Payloads | None = None,
    **options: Unpack[BatchOptions],
) -> Array:
    """Return a vector (order 1) or matrix (order 2) over the actuated joints at poses."""
    require_kind("robot", robot, Robot, "pm.load")
    robot.require_regular_drives(from_home=False)
    model = model_with_payloads(robot, payloads)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        from pm3dof_pin.dynamics.traced import of_drives

        return of_drives(name, robot, model, q, threads)

    return evaluate_at(
        robot,
        poses,
        name,
        (len(robot.actuated_joints),) * order,
        program=program,
        reference=lambda q: reference(robot.configuration(q), payloads),
        program_from=_PROGRAM_FROM,
        **options,
    ).values


def natural_frequencies(
    elastic: ElasticModel,
    poses: Poses | ArrayLike,
    *,
    count: int,
    payloads: Payloads | None = None,
    **options: Unpack[BatchOptions],
) -> Array:
    """Compute the lowest natural frequencies at many poses, ascending, shape=(..., count) [Hz]; NaN if there are fewer.

    Other arguments as in :func:`actuator_forces`, with q of the rigid mechanism.

    Raises:
        PM3DofError: as :func:`~pm3dof_pin.dynamics.modes.natural_modes`.
    """
    require_kind("elastic", elastic, ElasticModel, "pm.ElasticModel.load")
    elastic.mechanism.require_possible_inertias()
    model = model_with_payloads(elastic.mechanism, payloads)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        from pm3dof_pin.dynamics.traced import vibrations

        matrices, sound = vibrations(elastic, model, q, threads)
        matrices[~sound] = 0.0
        return _frequencies(np.linalg.eigvalsh(matrices)[:, ::-1], count), sound

    def reference(q: Vector) -> Vector:
        found = natural_modes(elastic, q, count=count, payloads=payloads).frequencies
        return np.append(found, np.full(count - len(found), np.nan))

    return evaluate_at(
        elastic.rigid,
        poses,
        "natural frequencies",
        (count,),
        program=program,
        reference=reference,
        program_from=_PROGRAM_FROM,
        **options,
    ).values


def _frequencies(inverse_squares: NDArray[Any], count: int) -> Matrix:
    """Return frequencies from descending 1 / omega^2, shape=(n, count) [Hz]."""
    found = np.full((len(inverse_squares), count), np.nan)
    first = inverse_squares[:, :count]
    has_mass = first > MASSLESS * inverse_squares[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        found[:, : first.shape[1]] = np.where(has_mass, 1.0 / (2.0 * np.pi * np.sqrt(first)), np.nan)
    return found
