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
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, ToolComponent
from pm3dof_pin.exceptions import InvalidValueError, ProgramError, SingularConfigurationError, first_words
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.closing_programs import BoundProgram, quantity_program
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom, Restriction
from pm3dof_pin.kinematics.pose_values import PROGRAM_FROM, BatchOptions, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.mechanism.tool_components import angle_rates, tool_components
from pm3dof_pin.programs.closed_motions import all_motions
from pm3dof_pin.programs.derivatives import derivatives
from pm3dof_pin.programs.elimination import DROPPED, Doubt, eliminate, identity, product, samples, solve_upper, zeros
from pm3dof_pin.programs.graph import Graph, Scalar, sqrt
from pm3dof_pin.programs.joints import objects
from pm3dof_pin.programs.loops import checked_program
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix, Objects, Vector

MotionName: TypeAlias = Literal["coordinates", "commands", "joints", "tool"] | str | Sequence[str]
"""A description of motion: "coordinates", "commands", "joints" (all single-DoF ones), "tool" (its twist), the name of a
frame (its twist), or names of joints, coordinates and commands."""

_MANY = 100  # joints, from which recording takes a second and a second way seldom saves operations
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Rate:
    """A scalar rate: scale times that of a joint, or a component of a frame's twist, or of the tool's angles."""

    name: str
    unit: str  #: "m/s" or "rad/s"
    scale: float = 1.0
    joint: str | None = None
    frame: str | None = None
    component: ToolComponent | None = None
    is_angle: bool = False  #: the rate of rx, ry or rz, not the angular velocity


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
                return tuple(map(_of_coordinate, robot.coordinates))
            case "commands":
                return tuple(map(_of_coordinate, robot.command_coordinates))
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


def _of_coordinate(coordinate: Coordinate) -> Rate:
    unit = f"{coordinate.unit}/s"
    if coordinate.joint is not None:
        return Rate(coordinate.name, unit, coordinate.scale, joint=coordinate.joint)
    return Rate(coordinate.name, unit, coordinate.scale, component=coordinate.tool, is_angle=coordinate.unit == "rad")


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
            return _of_coordinate(coordinate)
    known = [*robot.model.names][1:] + [c.name for c in (*robot.coordinates, *robot.command_coordinates)]
    raise InvalidValueError(argument, name, f"a joint, coordinate or command: {', '.join(dict.fromkeys(known))}")


def _frame(robot: Robot, rate: Rate) -> str:
    return robot.frame_name(rate.frame)


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
        motions = self.motions
        count = len(self._by)
        found = np.empty((len(self._of), count, count))
        for i in range(count):
            for j in range(i + 1):
                terms = [self._acceleration(motions[:, i] + sign * motions[:, j]) for sign in (1.0, -1.0)]
                found[:, i, j] = found[:, j, i] = 0.25 * (terms[0] - terms[1])
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


def bound_jacobian(robot: Robot, of: Sequence[Rate], by: Sequence[Rate], *, with_derivatives: bool) -> BoundProgram:
    """Return the program of a Jacobian at q, kept for the robot; outputs and errors as :func:`jacobian_program`."""

    def trace() -> Program:
        poses = samples_near_home(robot)
        verify(robot, poses)
        return jacobian_program(robot, of, by, poses, with_derivatives=with_derivatives)

    own = ("jacobian", of, by, with_derivatives)
    return quantity_program(robot, own, trace, frames=_frames(robot, of, by))


def _frames(robot: Robot, *rates: Sequence[Rate]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(_frame(robot, rate) for group in rates for rate in group if rate.joint is None))


def jacobian_program(
    robot: Robot,
    of: Sequence[Rate],
    by: Sequence[Rate],
    poses: Matrix,
    *,
    with_derivatives: bool = False,
    dense: bool = False,
) -> Program:
    """Record a Jacobian; outputs `values`, flat, and `sound`, 1 if the loops are closed and nothing is in doubt.

    `poses` are closed configurations near home, shape=(s, nq); `dense` as for
    :class:`~pm3dof_pin.programs.tree.Tree`.

    Raises:
        ProgramError: the motions of `by` do not determine those of `of` at the sample poses.
    """
    doubt = Doubt()
    tree = Tree(Graph(), robot, poses, _frames(robot, of, by), dense=dense, in_working_axes=True)
    velocities, _ = recorded_motions(tree, by, of, doubt)
    values = product(_rows(tree, of), velocities)
    flat = values.ravel()
    if with_derivatives:
        rates = np.stack([tree.rate(velocities[:, column]) for column in range(len(by))], axis=-1)
        along = derivatives(values, dict(zip(tree.q, rates, strict=True)))
        flat = np.concatenate([flat, ((along + along.swapaxes(1, 2)) * 0.5).ravel()])
    return checked_program("jacobian", tree, flat, doubt)


def recorded_motions(tree: Tree, by: Sequence[Rate], of: Sequence[Rate], doubt: Doubt) -> tuple[Objects, Objects]:
    """Record the joint velocities at unit rate of each of `by`, shape=(nv, m) [SI units], and the idle motions.

    Idle motions, shape=(nv, i), are those that neither sees, such as a rod's spin about its own axis. Redundant rates
    that disagree are met by least squares. Of equally sparse joints the last follow first, or the first if the rates of
    `of` then take fewer operations.

    Raises:
        ProgramError: rates of `of` can change while those of `by` are at rest, at the sample poses.
    """
    joints = range(tree.mechanism.model.nv)
    ways = [(Doubt(), order) for order in (joints, joints[::-1])[: 2 if len(joints) < _MANY else 1]]
    found = [(*_motions_by(tree, by, of, order, own), own) for own, order in ways]
    wanted = _rows(tree, of)
    motions, idle, own = min(found, key=lambda way: tree.graph.operations(*product(wanted, way[0]).ravel()))
    doubt.note_pivot(own.pivot)
    doubt.drop([own.dropped])
    return motions, idle


def _motions_by(
    tree: Tree, by: Sequence[Rate], of: Sequence[Rate], order: Sequence[int], doubt: Doubt
) -> tuple[Objects, Objects]:
    """Record what :func:`recorded_motions` does, with joints in an order, see :func:`all_motions`."""
    robot = tree.mechanism
    unit, slides = robot.length_unit, tree.slides
    basis = all_motions(tree, order, unit, doubt)
    basis[slides] = basis[slides] * unit
    factors = [
        np.array([[1.0 / ((unit if rate.unit == "m/s" else 1.0) * abs(rate.scale))] for rate in rates])
        for rates in (of, by)
    ]
    wanted, given = (_rows(tree, rates) * scale for rates, scale in zip((of, by), factors, strict=True))
    solved = eliminate(product(given, basis), range(basis.shape[1]), doubt)
    pivots, dropped = list(solved.columns), list(solved.dropped)
    if len(pivots) < min(len(by), basis.shape[1] - len(dropped)):
        raise ProgramError(f"{robot.name}: the rates that are given depend on each other")
    triangle = solved.pivot_rows[:, pivots]
    doubt.note_basis(triangle)
    at_rest = zeros(basis.shape[1], len(dropped))  # motions that the given rates do not see
    for column, index in enumerate(dropped):
        at_rest[index, column] = 1.0
    at_rest[pivots] = -solve_upper(triangle, solved.pivot_rows[:, dropped])
    for entry in product(product(wanted, basis), at_rest).ravel():
        if np.nanmax(np.abs(samples(entry))) > DROPPED:
            raise ProgramError(
                f"{robot.name}: wanted rates can move while the given ones are at rest: expected as "
                "many given rates as determine them; declare further coordinates, such as joints of the arm or the legs"
            )
        doubt.drop([entry])
    rates: Objects = product(basis[:, pivots], solve_upper(triangle, solved.carry(identity(len(by)))[0]))
    return rates * factors[1].T, product(basis, at_rest)


def _rows(tree: Tree, rates: Sequence[Rate]) -> Objects:
    """Record the derivatives of rates by v, shape=(k, nv)."""
    robot = tree.mechanism
    rows = zeros(len(rates), robot.model.nv)
    for k, rate in enumerate(rates):
        if rate.joint is not None:
            rows[k, robot.single_joint(rate.joint).v_index] = rate.scale
            continue
        name = robot.frame_name(rate.frame)
        twist = tree.jacobian(name)
        index = TOOL_COMPONENTS.index(rate.component)
        row = _angle_row(tree, name, index - 3) @ twist[3:] if rate.is_angle else twist[index]
        rows[k] = row * rate.scale
    return rows


def _angle_row(tree: Tree, frame: str, index: int) -> Objects:
    """Record the rate of rx, ry or rz by the angular velocity, see :func:`angle_rates`, shape=(3,)."""
    r = tree.in_world(tree.frame(frame)).rotation
    cy: Scalar = sqrt(r[0, 0] * r[0, 0] + r[0, 1] * r[0, 1])
    cx, sx, sy = r[2, 2] / cy, -r[1, 2] / cy, r[0, 2]
    match index:
        case 0:
            return objects([1.0, sx * sy / cy, -cx * sy / cy])
        case 1:
            return objects([0.0, cx, sx])
    return objects([0.0, -sx / cy, cx / cy])
