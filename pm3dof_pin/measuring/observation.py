"""The observation: what an instrument measures of a machine, from where, between which points.

Rows of a pose are in the order of the instrument's targets, for each in that of what they are measured against. A
machine goes on until a probe touches or a lock snaps in, so such a row has no number: its commands are the measurement.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pm3dof_pin.errors.command_correction import command_jacobians
from pm3dof_pin.exceptions import PM3DofError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.datum import Datum
from pm3dof_pin.measuring.instrument import Instrument, PlacedDatum
from pm3dof_pin.measuring.instruments.kind import TOUCHING
from pm3dof_pin.measuring.joint_columns import encoder_column
from pm3dof_pin.measuring.measurements import Measurements, joint_coordinates
from pm3dof_pin.typing import Array

_ROUNDS = 12
_STEP = 1e-6  # of commands [m, rad]
_UNDRIVEN = 1e-6  # of the greatest motion by the drives: no motion


def planned_measurements(poses: Poses, instrument: Instrument) -> Measurements:
    """Return what an instrument would see of poses, as many rows for each, in their order.

    Raises:
        InvalidValueError: an encoder of a joint without one.
    """
    return with_encoders(observed(poses.commands, poses.transforms, instrument), poses.robot, poses.q, instrument)


def with_encoders(found: Measurements, robot: Robot, q: Array, instrument: Instrument) -> Measurements:
    """Return observations with the readings of the instrument's encoders, in the first row of each pose.

    Args:
        found: rows, as many of each pose.
        robot: the robot.
        q: coordinates of its joints at each pose, shape=(n, nq).
        instrument: what measures, and reads encoders.

    Raises:
        InvalidValueError: an encoder of a joint that is driven.
    """
    if not instrument.encoders:
        return found
    for joint in instrument.encoders:
        encoder_column(robot, joint)
    joints: dict[str, str] = {joint: robot.single_joint(joint).unit for joint in instrument.encoders}
    rows = len(found) // len(q)
    noise = [instrument.position_sigma if unit == "m" else instrument.angle_sigma for unit in joints.values()]
    sigmas = np.full((len(found), len(joints)), np.inf)
    sigmas[::rows] = noise
    return found.with_encoders(joints, np.repeat(joint_coordinates(robot, q, tuple(joints)), rows, axis=0), sigmas)


def observed(commands: Array, transforms: Array, instrument: Instrument) -> Measurements:
    """Return what an instrument without noise sees of poses of the tool, without encoders.

    Args:
        commands: readings of the drives' counters, shape=(n, number of commands) [m, rad].
        transforms: the poses, shape=(n, 4, 4).
        instrument: what measures.
    """
    placed = instrument.placed
    if instrument.locked:
        found = Measurements.from_poses(commands, transforms, instrument)
        return replace(found, sigmas=np.full_like(found.sigmas, np.inf))
    if not placed:
        return Measurements.from_poses(commands, transforms, instrument)
    targets = np.array(instrument.targets)
    rows = np.repeat(np.arange(len(commands)), len(targets) * len(placed))
    offsets = np.tile(np.repeat(targets, len(placed), axis=0), (len(commands), 1))
    against = np.tile(np.arange(len(placed)), len(commands) * len(targets))
    at = transforms[rows]
    points = at[:, :3, 3] + np.einsum("nij,nj->ni", at[:, :3, :3], offsets)
    sigmas = np.full((len(rows), 3), np.inf)
    found = Measurements(commands[rows], at[:, :3, 3], None, np.ones((len(rows), 3)), offsets)
    found = replace(found, target_sigma=instrument.target_sigma)
    if instrument.known_centres:
        sigmas[:, 0] = instrument.position_sigma
        origins = np.array([each.origin for each in placed])[against]
        distances = np.linalg.norm(points - origins, axis=1)
        return replace(found, distances=distances, origins=origins, partners=np.full(len(rows), -1), sigmas=sigmas)
    datums = []
    for k, each in enumerate(placed):
        own = against == k
        numbers = -each.datum(np.zeros((len(rows), each.kind.dimension)), k + 1).residuals(points)
        datum = each.datum(np.where(own[:, None], numbers, np.nan), k + 1).above_a_plane(points, own)
        datums.append(datum.at_its_depth(points))
        sigmas[own, : each.kind.dimension] = instrument.position_sigma
    return replace(found, sigmas=sigmas, datums=tuple(datums))


def touching_poses(poses: Poses, instrument: Instrument) -> Poses:
    """Move poses until the instrument touches, by Newton's method on the commands, and return those that do.

    Raises:
        UnreachablePoseError: none can, or only the machine as described: the drives do not move the point across.
    """
    target = _target(instrument)
    if target is None:
        return poses
    at = poses
    for _ in range(_ROUNDS):
        gaps = target.gaps(at.robot, at.transforms, at.q)
        if np.abs(gaps).max(initial=0.0) < TOUCHING:
            break
        at = poses.robot.forward(at.commands + target.steps(at, at.transforms, gaps), guess=at.q, on_failure="nan")
        at = at[at.solved]
        if not len(at):
            break
    if len(at):
        gaps = target.gaps(at.robot, at.transforms, at.q)
        at = at[(np.abs(gaps).max(axis=1) < TOUCHING) & at.within_limits]
    if not len(at):
        raise UnreachablePoseError(f"{poses.robot.name}: {target.name} is out of reach of the point that touches")
    rates = np.linalg.svd(target.rates(at, at.transforms), compute_uv=False)
    driven = rates[:, -1] > _UNDRIVEN * rates[:, 0]
    if not driven.any() or rates.shape[1] < target.dimension:
        raise UnreachablePoseError(
            f"{poses.robot.name}: a machine with errors misses {target.name}, and no drive moves the point that "
            "touches across it; touch with another point of the tool, or elsewhere"
        )
    return at[driven]


def touching_commands(
    robot: Robot,
    commands: Array,
    machine: Callable[[Array], tuple[Array, Array]],
    instrument: Instrument,
    off: Array,
) -> Array:
    """Return the commands at which a machine touches, from those at which the described one about does.

    Args:
        robot: the machine as described, whose derivatives are used.
        commands: where to start, shape=(n, number of commands) [m, rad].
        machine: the true poses at commands, shape=(n, 4, 4), and the joints' coordinates, shape=(n, nq).
        instrument: what touches; one that does not stop the machine leaves the commands as they are.
        off: by how much it triggers too early, shape=(n, dimension) [m].

    Raises:
        UnreachablePoseError: some cannot be touched.
    """
    target = _target(instrument)
    if not instrument.stops or target is None:
        return commands
    missing = f"{robot.name}: a pose does not reach {target.name}"
    for _ in range(_ROUNDS):
        try:
            transforms, q = machine(commands)
            gaps = target.gaps(robot, transforms, q) + off
            steps = target.steps(robot.forward(commands), transforms, gaps)
        except PM3DofError as error:
            raise UnreachablePoseError(missing) from error
        if np.abs(gaps).max() < TOUCHING:
            return commands
        commands = commands + steps
    raise UnreachablePoseError(missing)


class _Target(ABC):
    """What a machine is moved to before it is measured."""

    name: str  #: in words
    dimension: int  #: d, in how many directions it can be missed

    @abstractmethod
    def gaps(self, robot: Robot, transforms: Array, q: Array) -> Array:
        """Return what is missing, shape=(n, d) [m, rad]."""

    @abstractmethod
    def rates(self, poses: Poses, transforms: Array) -> Array:
        """Return the derivatives of what is reached by the commands, shape=(n, d, commands)."""

    def steps(self, poses: Poses, transforms: Array, gaps: Array) -> Array:
        """Return the least steps of the commands towards it, shape=(n, commands) [m, rad]."""
        return np.asarray(np.einsum("nij,nj->ni", np.linalg.pinv(self.rates(poses, transforms), rcond=_UNDRIVEN), gaps))


class _Touch(_Target):
    """A target on the tool touches."""

    def __init__(self, touched: PlacedDatum, offset: Array) -> None:
        place = " ".join(f"{value:.4g}" for value in touched.origin)
        self.name, self.dimension = f"the {touched.kind.name} at {place}", touched.kind.dimension
        self._touched, self._offset = touched, offset

    def gaps(self, robot: Robot, transforms: Array, q: Array) -> Array:
        points = self._points(transforms)
        return self._datum(points).residuals(points)

    def rates(self, poses: Poses, transforms: Array) -> Array:
        motions, arms, points = command_jacobians(poses), poses.rotations @ self._offset, self._points(transforms)
        linear = motions[:, :3] + np.cross(motions[:, 3:], arms[:, :, None], axisa=1, axisb=1, axisc=1)
        return np.asarray(self._datum(points).directions(points) @ linear)

    def _points(self, transforms: Array) -> Array:
        return np.asarray(transforms[:, :3, 3] + transforms[:, :3, :3] @ self._offset)

    def _datum(self, points: Array) -> Datum:
        assert self._touched.touch is not None
        return self._touched.datum(np.tile(self._touched.touch, (len(points), 1)))


class _Lock(_Target):
    """Passive joints are where they are locked."""

    def __init__(self, joints: tuple[str, ...], held: Array) -> None:
        self.name, self.dimension = f"the lock of {', '.join(joints)}", len(joints)
        self._joints, self._held = joints, held

    def gaps(self, robot: Robot, transforms: Array, q: Array) -> Array:
        return np.asarray(self._held - joint_coordinates(robot, q, self._joints))

    def rates(self, poses: Poses, transforms: Array) -> Array:
        robot, columns = poses.robot, []
        for step in _STEP * np.eye(poses.commands.shape[1]):
            ends = (robot.forward(poses.commands + side * step, guess=poses.q) for side in (1.0, -1.0))
            ahead, back = (joint_coordinates(robot, end.q, self._joints) for end in ends)
            columns.append((ahead - back) / (2.0 * _STEP))
        return np.stack(columns, axis=2)


def _target(instrument: Instrument) -> _Target | None:
    if instrument.locked:
        return _Lock(instrument.encoders, np.array(instrument.locked))
    touched = next((each for each in instrument.placed if each.touch is not None), None)
    return None if touched is None else _Touch(touched, np.array(instrument.targets[0]))
