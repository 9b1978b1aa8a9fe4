"""All assembly modes of a robot at given commands, found from random starts, and how complete the list is.

Starts are drawn until each mode found was met several times. What was met once and twice then says how many are missing
(A. Chao, Scandinavian Journal of Statistics 11, 1984), and what was met least how likely a mode as rare as that would
have been missed. Where most starts end in different modes there are too many to find them all, unless the drives leave
the robot free to move there, which has no modes.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, require_count, require_kind
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError, first_words
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reference import assemble_at
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Matrix, Vector

_AT_ONCE = 1024  # starts, by programs
_AT_ONCE_WITHOUT = 64
_WORK_WITHOUT = 5e6  # the same times the cube of the number of velocities: some seconds of large robots
_FRUITLESS = 16  # rounds after which no mode is expected any more, and the most of large robots without programs
_REACH = 2.0  # largest travel of sliding joints from home [characteristic lengths]
_SAME = 1e-6  # distance of joints and of the tool's axes that are the same [characteristic lengths]
_TOO_MANY = 200  # modes, if most starts end in different ones: too many, or not isolated
_SAMPLE = 20  # of these, whose null motions say which
_STEP = 1e-4  # along a null motion, which moves what tells modes apart by about as much [characteristic lengths, rad]

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class AssemblyModes:
    """The ways to assemble a robot at given commands, that of home's branch first if it exists."""

    poses: Poses  #: one for each mode, shape=(k,), the joints as near to home as was found
    counts: tuple[int, ...]  #: how many starts led to each
    starts: int  #: number of random starts
    from_home: bool  #: whether the first is reached from home
    more: bool = False  #: whether the search ended since there are too many, most of them not found

    @property
    def estimated(self) -> float:
        """Estimated number of modes: Chao's lower bound, from how many were met once and twice."""
        once, twice = (self.counts.count(times) for times in (1, 2))
        return len(self.counts) + once * (once - 1) / (2.0 * (twice + 1))

    @property
    def missed(self) -> float:
        """Probability that a further mode, as rarely met as the rarest of these, was not met."""
        return math.exp(-min(self.counts, default=0))


def assembly_modes(
    robot: Robot, commands: ArrayLike, *, times: int = 5, max_starts: int = 50_000, seed: int = 0
) -> AssemblyModes:
    """Find the assembly modes at commands by damped Newton steps from random starts. Deterministic.

    Modes are told apart by the places of the joints, the closures and the tool; spins of rods, and turns of a universal
    joint's cross that leave its rod where it is, make no difference.

    Example:
        The tripod's legs can be assembled in eight ways:

        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.kinematics.assembly_modes import assembly_modes
        >>> modes = assembly_modes(pm.load("pm3dof"), [0.257, 0.26, 0.2245])
        >>> len(modes.poses), modes.estimated
        (8, 8.0)

    Args:
        robot: the robot.
        commands: readings of the drives' counters, shape=(number of commands,) [m, rad].
        times: how often each mode is to be met.
        max_starts: after which number of starts to stop in any case; of large robots without programs it is less.
        seed: of the random starts.

    Raises:
        InvalidValueError: the commands are not finite numbers, or have the wrong shape; or the robot has no joints.
        SingularConfigurationError: the drives do not determine the pose, so that modes are not isolated.
    """
    require_kind("robot", robot, Robot, "pm.load")
    if not robot.model.nv:
        raise InvalidValueError("robot", problem=f"{robot.name} has no joints", expected="joints to assemble")
    require_count("times", times)
    require_count("max_starts", max_starts)
    target = finite_array("commands", commands, (len(robot.commands),))
    reached = robot.forward(target, on_failure="nan")
    generator = np.random.default_rng(seed)
    found = np.zeros((0, robot.model.nq))
    features = np.zeros((0, _features(robot, robot.home.q[None]).shape[1]))
    if reached.solved:
        found = np.array(reached.q)[None]
        features = _features(robot, found)
    counts = [0] * len(found)
    starts, more = 0, False
    size = _AT_ONCE
    continuation = robot.continuation(robot.placing_commands)
    if continuation is None or not continuation.has_damped_steps:
        affordable = max(1, int(_WORK_WITHOUT / robot.model.nv**3))
        size, max_starts = min(_AT_ONCE_WITHOUT, affordable), min(max_starts, _FRUITLESS * affordable)
    while starts < max_starts:
        ends = _closed(robot, _random_starts(robot, generator, size), target)
        starts += size
        for q, place in zip(ends, _features(robot, ends), strict=True):
            distances = np.abs(features - place).max(axis=1)
            k = int(np.argmin(distances)) if len(distances) else 0
            if len(distances) and distances[k] <= _SAME:
                counts[k] += 1
                found[k] = min(found[k], q, key=lambda each: _distance(robot, each))
            else:
                found, features = np.vstack([found, q]), np.vstack([features, place])
                counts.append(1)
        if more := len(counts) > _TOO_MANY and 2 * len(counts) > sum(counts):
            if not _are_isolated(robot, found[-_SAMPLE:]):
                raise SingularConfigurationError(
                    f"{robot.name}: the drives {first_words(robot.actuated_joints)} do not determine the pose: "
                    "with these at rest the robot can move at most of the poses found"
                )
            break
        _logger.info("%s: %d modes from %d starts", robot.name, len(counts), starts)
        if counts and min(counts) >= times:
            break
        if not any(counts) and starts >= _FRUITLESS * size:
            break
    order = sorted(range(int(reached.solved), len(found)), key=lambda k: _distance(robot, found[k]))
    order = [0, *order] if reached.solved else order
    return AssemblyModes(
        Poses(robot, found[order]), tuple(counts[k] for k in order), starts, bool(reached.solved), more
    )


def _random_starts(robot: Robot, generator: np.random.Generator, count: int) -> Matrix:
    """Return random configurations, shape=(count, nq): any angles, and travels up to twice the robot's size."""
    model, home = robot.model, np.array(robot.home.q)
    ends = np.where(robot.velocity_scale == 1.0, math.pi, _REACH * robot.velocity_scale)
    moves = generator.uniform(-ends, ends, (count, model.nv))
    return np.array([pin.integrate(model, home, move) for move in moves])


def _closed(robot: Robot, starts: Matrix, target: Vector) -> Matrix:
    """Return the closed configurations at which starts end, with all commands as given, shape=(n, nq)."""
    coordinates = robot.placing_commands
    given = np.tile(target[robot.placing_drives], (len(starts), 1))
    if (continuation := robot.continuation(coordinates)) is not None:
        ends = continuation.ends(starts, given)
    else:
        results = [assemble_at(robot, coordinates, given[0], start) for start in starts]
        ends = np.array([result.q if result.converged else np.full(robot.model.nq, np.nan) for result in results])
    if len(coordinates) < len(target):
        ends = robot.agreeing(ends, np.tile(target, (len(ends), 1)))
    return _nearest_turns(robot, ends[np.isfinite(ends).all(axis=1)])


def _nearest_turns(robot: Robot, q: Matrix) -> Matrix:
    """Turn joints by whole turns to within half a turn of home."""
    home = np.array(robot.home.q)
    found = np.array(q)
    for joint, name in zip(robot.model.joints[1:], robot.model.names[1:], strict=True):
        if joint.nq == 1 and not robot.single_joint(name).translates:
            k = joint.idx_q
            found[:, k] -= 2.0 * math.pi * np.round((found[:, k] - home[k]) / (2.0 * math.pi))
    return found


def _features(robot: Robot, q: Matrix) -> Matrix:
    """Return what tells modes apart: places of joints and closures, and of the tool [characteristic lengths, 1]."""
    model, data, length = robot.model, robot.model.createData(), robot.characteristic_length
    tool = robot.tool_frame_id if robot.tool_frame is not None else None
    ends = [robot.frame_id(frame) for loop in robot.closures for frame in (loop.frame_a, loop.frame_b)]
    rows = []
    for each in q:
        pin.forwardKinematics(model, data, each)
        parts = [data.oMi[k].translation / length for k in range(1, model.njoints)]
        parts += [pin.updateFramePlacement(model, data, end).translation / length for end in ends]
        if tool is not None:
            placement = pin.updateFramePlacement(model, data, tool)
            parts += [placement.translation / length, placement.rotation.ravel()]
        rows.append(np.concatenate(parts))
    return np.array(rows)


def _are_isolated(robot: Robot, q: Matrix) -> bool:
    """Return whether at most poses no motion with the drives at rest moves what tells modes apart."""
    moved = []
    for each in q:
        freedom = DegreesOfFreedom(robot.configuration(each))
        steps = (_STEP * freedom.scale[:, None] * freedom.at_actuators.motions).T
        ends = np.array([each, *(pin.integrate(robot.model, each, step) for step in steps)])
        places = _features(robot, ends)
        moved.append(np.abs(places - places[0]).max() > 0.01 * _STEP)
    return bool(2 * sum(moved) < len(moved))


def _distance(robot: Robot, q: Vector) -> float:
    moves = pin.difference(robot.model, np.array(robot.home.q), q) / robot.velocity_scale
    return float(np.abs(moves).sum())
