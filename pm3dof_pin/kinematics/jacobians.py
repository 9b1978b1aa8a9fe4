"""One Jacobian between any two descriptions of a mechanism's motion: coordinates, commands, joints, twists of frames.

With closed loops the velocities are v = N c, N a basis of the null space of the constraint Jacobian. Rows O of one
description and B of another then give O v = J (B v) with J = O N (B N)^+, if nothing that O sees moves while B is at
rest. The derivative of J along the motions is the term that rates add to accelerations: for y = f(x) on the closed
loops, d2y/dt2 = J d2x/dt2 + H(dx/dt, dx/dt).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError, first_words
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom, Restriction
from pm3dof_pin.kinematics.jacobian_programs import Rate, bound_jacobian, rate_of_coordinate
from pm3dof_pin.kinematics.pose_values import PROGRAM_FROM, BatchOptions, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.mechanism.tool_components import angle_rates, tool_components
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

MotionName: TypeAlias = Literal["coordinates", "commands", "joints", "tool"] | str | Sequence[str]
"""A description of motion: "coordinates", "commands", "joints" (all single-DoF ones), "tool" (its twist), the name of a
frame (its twist), or names of joints, coordinates and commands."""

_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives of one description of motion by another, at many poses."""

    values: Array  #: J, shape=(..., k, m)
    rows: tuple[str, ...]  #: names of the k rates that it gives
    columns: tuple[str, ...]  #: names of the m rates that it takes
    row_units: tuple[str, ...]  #: "m/s" or "rad/s"
    column_units: tuple[str, ...]  #: "m/s" or "rad/s"
    #: derivatives H of J along the columns' motions, shape=(..., k, m, m), made symmetric in the last two:
    #: accelerations of the rows at constant rates x of the columns are x^T H x; None unless asked for
    derivatives: Array | None = None


def jacobian(
    robot: Robot,
    poses: Poses | Configuration | ArrayLike,
    *,
    of: MotionName,
    by: MotionName,
    with_derivatives: bool = False,
    **options: Unpack[BatchOptions],
) -> Jacobian:
    """Compute the derivative of one description of the motion by another.

    Example:
        Rates of the tripod's drives by those of its coordinates, J_t of equation (8.9):

        >>> import pm3dof_pin as pm
        >>> robot = pm.load("pm3dof")
        >>> J = pm.jacobian(robot, robot.solve([0.1, -0.2, 0.5]), of="commands", by="coordinates")
        >>> J.columns, J.values.shape
        (('theta_x', 'theta_y', 'z_e'), (3, 3))

    Args:
        robot: the robot.
        poses: solved poses, a configuration, or q with closed loops, shape=(..., nq) [m, rad].
        of: the description of motion that is wanted.
        by: the description that is given; its rates must determine those of `of`.
        with_derivatives: whether to compute :attr:`Jacobian.derivatives` too.
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Raises:
        SingularConfigurationError: something of `of` can move while all of `by` is at rest, or the rates of `by` cannot
            be chosen freely though they are no more than the degrees of freedom.
        InvalidValueError: a name is unknown, or a pose has open loops or the wrong shape.
        DescriptionError: the tool's motion is wanted, and the robot has no tool frame.
    """
    require_kind("robot", robot, Robot, "pm.load")
    rows, columns = motion_rates(robot, "of", of), motion_rates(robot, "by", by)
    k, m = len(rows), len(columns)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        return _evaluated(robot, rows, columns, q, threads, with_derivatives=with_derivatives)

    def reference(q: Vector) -> Vector:
        configuration = robot.configuration(q)
        point = ReferenceMotions(configuration, rows, columns)
        parts = [point.jacobian.ravel()]
        return np.concatenate([*parts, point.derivatives().ravel()] if with_derivatives else parts)

    size = k * m * (1 + m * with_derivatives)
    values = evaluate_at(
        robot, poses, "Jacobian", (size,), program=program, reference=reference, program_from=PROGRAM_FROM, **options
    ).values
    batch = values.shape[:-1]
    names = [tuple(rate.name for rate in rates) for rates in (rows, columns)]
    units = [tuple(rate.unit for rate in rates) for rates in (rows, columns)]
    return Jacobian(
        frozen(values[..., : k * m].reshape(*batch, k, m)),
        rows=names[0],
        columns=names[1],
        row_units=units[0],
        column_units=units[1],
        derivatives=frozen(values[..., k * m :].reshape(*batch, k, m, m)) if with_derivatives else None,
    )


def motion_rates(robot: Robot, argument: str, motion: MotionName) -> tuple[Rate, ...]:
    """Return the rates of a description of motion."""
    if isinstance(motion, str):
        match motion:
            case "coordinates":
                return tuple(map(rate_of_coordinate, robot.coordinates))
            case "commands":
                return tuple(map(rate_of_coordinate, robot.command_coordinates))
            case "joints":
                names = [
                    name
                    for name in list(robot.model.names)[1:]
                    if robot.model.joints[robot.model.getJointId(name)].nv == 1
                ]
                return tuple(_of_joint(robot, name) for name in names)
            case "tool":
                return _twist(robot.frame_name())
        if not _is_known(robot, motion):
            return _twist(robot.frame_name(motion))
        return (_named(robot, argument, motion),)
    if not motion:
        raise InvalidValueError(argument, "no names", "at least one")
    return tuple(_named(robot, argument, name) for name in motion)


def _of_joint(robot: Robot, name: str) -> Rate:
    return Rate(name, f"{robot.single_joint(name).unit}/s", joint=name)


def _twist(frame: str) -> tuple[Rate, ...]:
    units = ("m/s",) * 3 + ("rad/s",) * 3
    return tuple(
        Rate(name, unit, frame=frame, component=component)
        for name, unit, component in zip(_TWIST, units, TOOL_COMPONENTS, strict=True)
    )


def _is_known(robot: Robot, name: str) -> bool:
    known = {c.name for c in (*robot.coordinates, *robot.command_coordinates)}
    return name in known or name in list(robot.model.names)[1:]


def _named(robot: Robot, argument: str, name: str) -> Rate:
    """Return a rate by name: of a joint, or else of a coordinate, or else of a command."""
    if name in list(robot.model.names)[1:]:
        return _of_joint(robot, name)
    for coordinate in (*robot.coordinates, *robot.command_coordinates):
        if coordinate.name == name:
            return rate_of_coordinate(coordinate)
    known = [*robot.model.names][1:] + [c.name for c in (*robot.coordinates, *robot.command_coordinates)]
    raise InvalidValueError(argument, name, f"a joint, coordinate or command: {', '.join(dict.fromkeys(known))}")


class ReferenceMotions:
    """The Jacobian at one configuration, on Pinocchio's Jacobians and singular value decompositions.

    Attributes:
        jacobian: rates of `of` by those of `by`, shape=(k, m).
        motions: joint velocities at unit rate of each of `by`, shape=(nv, m).
        idle: basis of the motions with all of `by` at rest, shape=(nv, i).

    Raises:
        SingularConfigurationError: see :func:`jacobian`.
        InvalidValueError: the loops are not closed.
    """

    def __init__(self, configuration: Configuration, of: Sequence[Rate], by: Sequence[Rate]) -> None:
        self._configuration, self._of, self._by = configuration, of, by
        dof = DegreesOfFreedom(configuration)
        robot = configuration.mechanism
        scales = [self._scale(rate) * abs(rate.scale) for rate in (*of, *by)]  # counters may have any unit
        self._row_scale, self._column_scale = np.split(np.array(scales), [len(of)])
        wanted = self._rows(of) * dof.scale / self._row_scale[:, None]
        given = dof.over(self._rows(by) * dof.scale / self._column_scale[:, None])
        names = first_words([rate.name for rate in by])
        if Restriction(wanted, given.motions).rank.rank:
            alone = [rate.name for k, rate in enumerate(of) if Restriction(wanted[[k]], given.motions).rank.rank]
            raise SingularConfigurationError(
                f"{robot.name}: {first_words(alone or [rate.name for rate in of])} can move with {names} at rest, "
                f"at {configuration.in_words}"
            )
        if given.rank.rank < min(len(by), dof.count):
            raise SingularConfigurationError(
                f"{robot.name}: the rates of {names} depend on each other at {configuration.in_words}"
            )
        self._dof, self._given = dof, given
        self.motions: Matrix = dof.scale[:, None] * given.inverse / self._column_scale
        self.idle: Matrix = dof.scale[:, None] * given.motions
        scaled: Matrix = wanted @ given.inverse
        self.jacobian: Matrix = self._row_scale[:, None] * scaled / self._column_scale

    def derivatives(self) -> Array:
        """Return the derivative of the Jacobian along each column's motion, shape=(k, m, m), by polarisation."""
        motions = self.motions.T
        alone = np.array([self._acceleration(v) for v in motions])
        found = np.empty((len(self._of), len(motions), len(motions)))
        for i, v in enumerate(motions):
            found[:, i, i] = alone[i]
            for j in range(i):
                together = self._acceleration(v + motions[j])
                found[:, i, j] = found[:, j, i] = 0.5 * (together - alone[i] - alone[j])
        return found

    def _acceleration(self, v: Vector) -> Vector:
        """Return the accelerations of the rows at velocities v if those of the columns vanish."""
        dof, robot = self._dof, self._configuration.mechanism
        drift = robot.loop_kinematics.drift(self._configuration.q, v)
        start = -dof.closures.inverse @ (drift / robot.closure_scale)
        missing = -self._drifts(self._by, v) / self._column_scale - self._given.rows @ start
        a = dof.scale * (start + self._given.inverse @ missing)
        total: Vector = self._rows(self._of) @ a + self._drifts(self._of, v)
        return total

    def _scale(self, rate: Rate) -> float:
        return self._configuration.mechanism.characteristic_length if rate.unit == "m/s" else 1.0

    def _rows(self, rates: Sequence[Rate]) -> Matrix:
        """Return the derivatives of rates by v, shape=(k, nv)."""
        configuration = self._configuration
        robot = configuration.mechanism
        rows = np.zeros((len(rates), robot.model.nv))
        for row, rate in zip(rows, rates, strict=True):
            if rate.joint is not None:
                row[robot.single_joint(rate.joint).v_index] = rate.scale
                continue
            frame = configuration.frame_jacobian(robot.frame_name(rate.frame))
            index = TOOL_COMPONENTS.index(rate.component)
            turned = angle_rates(self._angles(rate))[index - 3] @ frame[3:] if rate.is_angle else frame[index]
            row[:] = rate.scale * turned
        return rows

    def _drifts(self, rates: Sequence[Rate], v: Vector) -> Vector:
        """Return the accelerations of rates at constant v, shape=(k,)."""
        robot, q = self._configuration.mechanism, np.array(self._configuration.q)
        model, data = robot.model, scratch_data(robot.model)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        drifts = np.zeros(len(rates))
        for k, rate in enumerate(rates):
            if rate.joint is not None:
                continue
            frame = robot.frame_id(robot.frame_name(rate.frame))
            motion = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            index = TOOL_COMPONENTS.index(rate.component)
            drift = motion.vector[index]
            if rate.is_angle:
                spin = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).angular
                drift = self._angle_drift(rate, spin, motion.angular)[index - 3]
            drifts[k] = rate.scale * drift
        return drifts

    def _angle_drift(self, rate: Rate, spin: Vector, acceleration: Vector) -> Vector:
        """Return the second derivatives of rx, ry, rz: the spin is e1 rx' + e2 ry' + e3 rz', with turning axes e."""
        angles = self._angles(rate)
        rates = angle_rates(angles) @ spin
        c, s = np.cos(angles[0]), np.sin(angles[0])
        third = np.array(self._configuration.frame_placement(self._configuration.mechanism.frame_name()).rotation[:, 2])
        turning = rates[1] * rates[0] * np.array([0.0, -s, c]) + rates[2] * np.cross(spin, third)
        found: Vector = angle_rates(angles) @ (acceleration - turning)
        return found

    def _angles(self, rate: Rate) -> Vector:
        robot = self._configuration.mechanism
        placement = self._configuration.frame_placement(robot.frame_name(rate.frame))
        return tool_components(placement.homogeneous)[3:]


def _evaluated(
    robot: Robot, of: Sequence[Rate], by: Sequence[Rate], q: Matrix, threads: int | None, *, with_derivatives: bool
) -> tuple[Array, Mask]:
    """Evaluate the compiled Jacobian at q, flat; and where nothing is in doubt, shape=(n,)."""
    return bound_jacobian(robot, of, by, with_derivatives=with_derivatives).with_doubt(q, threads)
