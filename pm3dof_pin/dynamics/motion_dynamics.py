"""Inertia and weight that a description of the motion feels: those of all bodies, projected on the closed motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.dynamics.mass_matrix import mass_matrix
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.closing_programs import BoundProgram, quantity_program
from pm3dof_pin.kinematics.jacobian_programs import Rate, recorded_motions
from pm3dof_pin.kinematics.jacobians import MotionName, ReferenceMotions, motion_rates
from pm3dof_pin.kinematics.pose_values import PROGRAM_FROM, BatchOptions, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.programs.elimination import Doubt, product, samples
from pm3dof_pin.programs.graph import Graph, sqrt
from pm3dof_pin.programs.loops import checked_program
from pm3dof_pin.programs.masses import Masses
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_NO_MASS = 1e-15
"""Idle motions of less mass than this, relative to that of all bodies times the length squared, are massless."""


@dataclass(frozen=True, eq=False)
class MotionDynamics:
    """What m rates feel of the masses at many poses."""

    inertia: Array  #: S^T M S, S the joint velocities at unit rates, shape=(..., m, m) [kg, kg m, kg m^2]
    weight: Array  #: forces along the rates that hold all bodies against gravity, shape=(..., m) [N, N m]


def motion_dynamics(
    robot: Robot,
    poses: Poses | Configuration | ArrayLike,
    *,
    by: MotionName,
    payloads: Payloads | None = None,
    **options: Unpack[BatchOptions],
) -> MotionDynamics:
    """Project the masses of all bodies on the motions at unit rate of each of `by`.

    Rotors count by the armature of their joints. Idle motions, such as the spin of a rod, follow freely: their momentum
    is zero.

    Args:
        robot: the robot.
        poses: solved poses, a configuration, or q with closed loops, shape=(..., nq) [m, rad].
        by: a description of motion, see :func:`~pm3dof_pin.kinematics.jacobians.jacobian`, that determines the actuated
            joints and the tool, if any.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia`.
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Raises:
        SingularConfigurationError: the rates do not determine the motion.
        PM3DofError: as :func:`~pm3dof_pin.kinematics.jacobians.jacobian`.
    """
    require_kind("robot", robot, Robot, "pm.load")
    robot.require_possible_inertias()
    model = model_with_payloads(robot, payloads)
    rates = motion_rates(robot, "by", by)
    seen, m = _seen(robot, rates), len(rates)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        return _program(robot, model, rates, seen).with_doubt(q, threads)

    def reference(q: Vector) -> Vector:
        configuration = robot.configuration(q)
        point = ReferenceMotions(configuration, seen, rates)
        mass = mass_matrix(configuration, payloads=payloads)
        motions, idle = point.motions, point.idle
        felt = idle.T @ mass
        if idle.size:
            motions = motions - idle @ np.linalg.lstsq(felt @ idle, felt @ motions, rcond=_NO_MASS)[0]
        weight = pin.computeGeneralizedGravity(model, scratch_data(model), q)
        return np.concatenate([(motions.T @ mass @ motions).ravel(), motions.T @ weight])

    values = evaluate_at(
        robot,
        poses,
        "inertia of motions",
        (m * (m + 1),),
        program=program,
        reference=reference,
        program_from=PROGRAM_FROM,
        **options,
    ).values
    inertia = values[..., : m * m].reshape(*values.shape[:-1], m, m)
    return MotionDynamics(frozen(inertia), frozen(values[..., m * m :]))


def motion_dynamics_program(robot: Robot, by: MotionName) -> BoundProgram:
    """Return the program of the inertia, then the weight, that m rates feel at q, shape=(m (m + 1),).

    Raises:
        ProgramError: there is no program for this robot.
    """
    rates = motion_rates(robot, "by", by)
    return _program(robot, robot.model, rates, _seen(robot, rates))


def _seen(robot: Robot, rates: tuple[Rate, ...]) -> tuple[Rate, ...]:
    """Return the rates that others must determine."""
    return motion_rates(robot, "of", robot.actuated_joints) if robot.actuated_joints else rates


def _program(robot: Robot, model: pin.Model, rates: tuple[Rate, ...], seen: tuple[Rate, ...]) -> BoundProgram:

    def trace() -> Program:
        poses = samples_near_home(robot)
        verify(robot, poses)
        doubt, tree = Doubt(), Tree(Graph(), robot, poses, in_working_axes=True)
        motions, idle = recorded_motions(tree, rates, seen, doubt)
        masses = Masses(tree, model)
        matrix = masses.matrix
        stack = np.hstack([idle, motions])
        inertia = product(stack.T, product(matrix, stack))
        weight = product(stack.T, masses.weights[:, None])[:, 0]
        reference = sum(body.mass for body in model.inertias) * robot.length_unit**2
        first = idle.shape[1]
        for k in range(first):  # idle motions follow such that their momentum is zero
            pivot, row = inertia[k, k], inertia[k].copy()
            if np.nanmax(np.abs(samples(pivot))) <= _NO_MASS * reference:
                doubt.drop([sqrt(pivot * (1.0 / reference))])
                continue
            inverse = 1.0 / pivot
            weight = weight - row * (weight[k] * inverse)
            inertia = inertia - np.outer(row, row) * inverse
        values = np.concatenate([inertia[first:, first:].ravel(), weight[first:]])
        return checked_program("motion_dynamics", tree, values, doubt)

    return quantity_program(robot, ("motion_dynamics", rates, seen), trace, model=model)
