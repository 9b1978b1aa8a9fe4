"""What a serial model must know of joints driven through closed loops: mapping, inertia, limits and gains.

The drives' rates are G times those of the joints, so that joint torques are G^T times the drives'. Rotors then add
G^T I_m G to the joints' inertia, gains K of the drives give G^T K G at the joints, and boxes of drive limits become
polytopes. All of these depend on the pose, and their off-diagonal entries couple the joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias, Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, require_kind
from pm3dof_pin.capability.polytopes import Polytopes
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.dynamics.motion_dynamics import motion_dynamics
from pm3dof_pin.exceptions import InvalidValueError, JointNotFoundError, SingularConfigurationError, first_words
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.pose_values import BatchOptions
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.loads import Payloads
from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.typing import Array, Vector

Limit: TypeAlias = float | Mapping[str, float] | ArrayLike | None
"""Limits of the drives, to either side: one for all, one each in their order, or by name; None for the described."""

_UNLIMITED = 1e300
_MARK = "\0"  # ends a name that other frames have as well
_SAME_VALUE = 1e-6  # differences of a joint's values that are rounding [rad, m]


def joint_driven(robot: Robot, joints: Sequence[str] = (), drives: Sequence[str] = ()) -> Robot:
    """Return a robot whose coordinates are joints, and whose drives are the given ones; by default those it has.

    Raises:
        JointNotFoundError: there is no such joint.
        InvalidValueError: a joint has several degrees of freedom, or one is named twice.
    """
    require_kind("robot", robot, Robot, "pm.load")
    for words, names in (("joints", joints), ("drives", drives)):
        if len(set(names)) < len(names):
            raise InvalidValueError(words, ", ".join(names), "each joint once")
        for name in names:
            robot.single_joint(name)
    coordinates = [Coordinate(name, robot.single_joint(name).unit, joint=name) for name in joints]
    if joints:
        robot = robot.replace(coordinates=tuple(coordinates))
    return robot.replace(actuated_joints=tuple(drives), commands=()) if drives else robot


def held_outside(robot: Robot, link: str, joints: Sequence[str] = ()) -> Robot:
    """Return what a link carries, as a robot of its own: the link and all other joints are held at home.

    Args:
        robot: the robot.
        link: the link.
        joints: joints that move the link itself and are not held either, as the first one of a leg.

    Raises:
        FrameNotFoundError: there is no such link.
        InvalidValueError: the link carries no joint, or a coupling ties a joint that it carries to one that is held.
        JointNotFoundError: there is no such joint.
    """
    require_kind("robot", robot, Robot, "pm.load")
    model = robot.model
    base = model.frames[robot.frame_id(link)].parentJoint
    above = {name for name in joints if _index(robot, name) in list(model.supports[base])}
    held = [
        name
        for k, name in enumerate(model.names)
        if k and base not in list(model.supports[k])[:-1] and name not in above
    ]
    if len(held) == model.njoints - 1:
        raise InvalidValueError("subtree", link, "a link that carries joints")
    return _held(robot, held, robot.home.q)


def held_as_described(robot: Robot, joints: Sequence[str]) -> Robot:
    """Return a robot without some joints, which are held where the description has them, as springs at rest.

    Springs are left out, and so are drives, commands and limits of held joints, and closures between held bodies.

    Raises:
        JointNotFoundError: there is no such joint.
        InvalidValueError: a coupling ties a joint that is held to one that is not.
    """
    require_kind("robot", robot, Robot, "pm.load")
    return _held(robot, joints, robot.described_home.q)


def _held(robot: Robot, joints: Sequence[str], q: Vector) -> Robot:
    model = robot.model
    held = [_index(robot, name) for name in joints]
    carried = {k for k in range(1, model.njoints) if k not in held}
    names = {model.names[k] for k in carried}
    for coupling in robot.couplings:
        tied = {coupling.joint, *coupling.joints}
        if tied & names and not tied <= names:
            raise InvalidValueError(
                "held joints", ", ".join(sorted(tied - names)), f"all joints of {coupling.name}, or none"
            )

    def moves(frame: str) -> bool:  # by index: a joint may have the name of a link
        return not carried.isdisjoint(model.supports[model.frames[robot.frame_id(frame)].parentJoint])

    reduced = _reduced(model, held, np.array(q))
    commands = tuple(command for command in robot.commands if command.joint in names)
    return robot.replace(
        model=reduced,
        closures=[loop for loop in robot.closures if moves(loop.frame_a) or moves(loop.frame_b)],
        couplings=tuple(coupling for coupling in robot.couplings if coupling.joint in names),
        actuated_joints=tuple(name for name in robot.actuated_joints if name in names),
        motion_coordinates=(),
        commands=commands,
        coordinates=tuple(c for c in robot.declared_coordinates if c.joint is None or c.joint in names),
        limit_groups=(),
        springs=(),
        tool_frame=robot.tool_frame if robot.tool_frame is not None and moves(robot.tool_frame) else None,
    )


def _index(robot: Robot, name: str) -> int:
    if not robot.model.existJointName(name):
        raise JointNotFoundError(name, robot.name, list(robot.model.names)[1:])
    return int(robot.model.getJointId(name))


def _reduced(model: pin.Model, held: list[int], q: Vector) -> pin.Model:
    """Return a model without some joints, which are held at q; frames may share their names."""
    model, joints, seen = model.copy(), set(model.names), set()
    for index, frame in enumerate(model.frames):  # Pinocchio looks for frames by their names alone
        is_joint = frame.type == pin.FrameType.JOINT
        if not is_joint and (frame.name in joints or frame.name in seen):
            frame.name += f"{_MARK}{index}"
        seen.add(frame.name)
    reduced = pin.buildReducedModel(model, held, q)
    for frame in reduced.frames:
        frame.name = frame.name.partition(_MARK)[0]
    return reduced


@dataclass(frozen=True, eq=False)
class Transmission:
    """The transmission between drives and joints at many poses, shape=(...)."""

    joints: tuple[str, ...]  #: names of the m joints
    drives: tuple[str, ...]  #: names of the u actuated joints
    poses: Poses  #: the poses
    #: values of the joints that were asked for, also where these are out of reach, shape=(..., m) [rad, m]
    asked: Array
    jacobian: Array  #: G, rates of the drives by those of the joints, shape=(..., u, m)
    #: second derivatives H of the drives' positions by those of the joints, shape=(..., u, m, m): the drives accelerate
    #: by G a + v^T H v
    jacobian_derivatives: Array
    rotor_inertia: Array  #: G^T I_m G of the drives' armatures, shape=(..., m, m) [kg m^2, kg]
    inertia: Array  #: of all moving bodies and rotors, shape=(..., m, m) [kg m^2, kg]
    weight: Array  #: joint torques that hold all bodies against gravity, shape=(..., m) [N m, N]
    effort: Vector  #: greatest effort of each drive, to either side, shape=(u,) [N m, N]; infinite if unknown
    speed: Vector  #: greatest speed of each drive, to either side, shape=(u,) [rad/s, m/s]; infinite if unknown

    @cached_property
    def axes(self) -> tuple[Vector, ...]:
        """Values of each joint along its dimension of a grid of poses, shape=(n,) each [rad, m].

        Raises:
            InvalidValueError: the poses are not a grid with one dimension for each joint, in their order; or solved
                poses were given, and all of a value are out of reach.
        """
        count = len(self.joints)
        if self.asked.ndim != count + 1:
            raise InvalidValueError(
                "transmission", f"poses of shape {self.poses.shape}", f"a grid with {count} dimensions"
            )
        axes = []
        for k, joint in enumerate(self.joints):
            lines = np.moveaxis(self.asked[..., k], k, 0).reshape(self.asked.shape[k], -1)
            if np.isnan(lines).all(axis=1).any():
                raise InvalidValueError("transmission", f"no pose at a value of {joint}", "a grid instead of its poses")
            axis = np.nanmin(lines, axis=1)
            if (np.nanmax(lines, axis=1) - axis > _SAME_VALUE).any():
                raise InvalidValueError(
                    "transmission", f"a grid along which {joint} varies twice", ", ".join(self.joints)
                )
            axes.append(frozen(axis))
        return tuple(axes)

    @cached_property
    def torques(self) -> Polytopes:
        """Torques that the drives can give at the joints beyond those that hold the weight [N m, N].

        Raises:
            InvalidValueError: the effort of a drive is unknown or zero.
        """
        self._require_limits("effort", self.effort)
        return self._torques(self.effort, -self.weight)

    @cached_property
    def total_torques(self) -> Polytopes:
        """Torques that the drives can give at the joints, what holds the weight included [N m, N]; errors as above."""
        self._require_limits("effort", self.effort)
        return self._torques(self.effort, np.zeros(len(self.joints)))

    @cached_property
    def unit_torques(self) -> Polytopes:
        """Torques at the joints with every drive limited to 1 N m (or N), without gravity."""
        return self._torques(np.ones(len(self.drives)), np.zeros(len(self.joints)))

    @cached_property
    def speeds(self) -> Polytopes:
        """Speeds of the joints that all drives can follow [rad/s, m/s].

        Raises:
            InvalidValueError: the speed of a drive is unknown or zero.
        """
        self._require_limits("speed", self.speed)
        return Polytopes.from_inequalities(self.jacobian, -self.speed, self.speed)

    @cached_property
    def pure_torques(self) -> Array:
        """Greatest torque about each joint alone, in the weaker direction, shape=(..., m) [N m, N]."""
        return _pure(self.torques, len(self.joints))

    @cached_property
    def pure_total_torques(self) -> Array:
        """Greatest torque about each joint alone, what holds the weight included, shape=(..., m) [N m, N].

        This is the effort limit of a serial model, whose bodies have weight as well.
        """
        return _pure(self.total_torques, len(self.joints))

    @cached_property
    def torque_box(self) -> Array:
        """Half edges of the greatest box of torques about the origin, in proportion to :attr:`pure_torques`.

        All joints can have these at once, in any combination, beyond what holds the weight, shape=(..., m) [N m, N].
        """
        share = self.torques.box_share(self.pure_torques)
        return frozen(share[..., None] * self.pure_torques)

    @cached_property
    def unit_pure_torques(self) -> Array:
        """The same without gravity, in multiples of the effort of the drives, shape=(..., m)."""
        return _pure(self.unit_torques, len(self.joints))

    @cached_property
    def pure_speeds(self) -> Array:
        """Greatest speed of each joint alone, shape=(..., m) [rad/s, m/s]."""
        return _pure(self.speeds, len(self.joints))

    @cached_property
    def distance_to_singularity(self) -> Array:
        """Least singular value of G over the greatest, shape=(...): 0 where the drives lose a joint."""
        values = _singular_values(self.jacobian)
        return frozen(values[..., -1] / values[..., 0])

    def joint_gains(self, gains: ArrayLike) -> Array:
        """Return the gains at the joints of those of the drives: G^T K G, shape=(..., m, m) [N m/rad or N m s/rad].

        Args:
            gains: of each drive, shape=(u,).
        """
        diagonal = finite_array("gains", np.broadcast_to(gains, (len(self.drives),)), (len(self.drives),))
        return np.asarray(np.einsum("...um,u,...un->...mn", self.jacobian, diagonal, self.jacobian))

    def drive_gains(self, gains: ArrayLike) -> Array:
        """Return the gains of the drives that give gains of the joints: G^-T K G^-1, shape=(..., u, u).

        Drives with controllers of their own have only its diagonal, which gives the joints :meth:`joint_gains` of it.
        NaN where the drives lose a joint.

        Args:
            gains: of each joint, shape=(m,), or a matrix, shape=(m, m).

        Raises:
            InvalidValueError: there are more drives than joints.
        """
        count = len(self.joints)
        if len(self.drives) != count:
            raise InvalidValueError("drives", f"{len(self.drives)} drives", f"{count}, as many as joints")
        given = np.asarray(gains, dtype=float)
        matrix = np.diag(np.broadcast_to(given, (count,))) if given.ndim < 2 else given
        inverse = np.full_like(self.jacobian, np.nan)
        sound = self.distance_to_singularity > ROUNDING
        inverse[sound] = np.linalg.inv(self.jacobian[sound])
        return np.asarray(inverse.swapaxes(-1, -2) @ matrix @ inverse)

    def _torques(self, effort: Vector, centre: ArrayLike) -> Polytopes:
        return Polytopes.from_box(self.jacobian.swapaxes(-1, -2), -effort, effort, centre=centre)

    def _require_limits(self, name: str, limits: Vector) -> None:
        for drive, limit in zip(self.drives, limits, strict=True):
            if not 0.0 < limit < _UNLIMITED:
                value = "zero" if limit == 0.0 else "not described"
                raise InvalidValueError(
                    f"{name} of {drive}", value, f"a positive {name}: --{name}, or in the description"
                )


def transmission(
    robot: Robot,
    values: Grid | ArrayLike | Poses,
    *,
    effort: Limit = None,
    speed: Limit = None,
    armature: Limit = None,
    payloads: Payloads | None = None,
    **options: Unpack[BatchOptions],
) -> Transmission:
    """Compute the transmission between the drives and the coordinates of a robot.

    Args:
        robot: the robot; see :func:`joint_driven` for one with joints as coordinates.
        values: a grid over the joints, or their values, shape=(..., m) [rad, m]; or solved poses.
        effort: limits of the drives' torques or forces [N m, N].
        speed: limits of their rates [rad/s, m/s].
        armature: inertia of the rotors, as felt at the actuated joints [kg m^2, kg]; by default the description's.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia`.
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Raises:
        SingularConfigurationError: the drives do not determine the joints at a pose, or the joints not the drives.
        UnreachablePoseError: a pose is out of reach, and `on_failure` is "raise".
        InvalidValueError: a limit is negative, or names no drive.
    """
    require_kind("robot", robot, Robot, "pm.load")
    names, drives = tuple(c.name for c in robot.coordinates), robot.actuated_joints
    if len(drives) < len(names) or not drives:
        problem = f"the drives ({first_words(drives)}) cannot determine {first_words(names)}"
        problem = problem if drives else "there are no drives"
        raise SingularConfigurationError(f"{robot.name}: {problem}: name the driven joints, as with --drives A,B")
    robot.require_regular_drives(from_home=False)
    if isinstance(values, Poses):
        poses, asked = values, values.coordinates
    else:
        poses = robot.solve(values, on_failure=options.get("on_failure", "raise"))
        asked = values.values if isinstance(values, Grid) else np.array(values, dtype=float)
    found = jacobian(robot, poses, of=drives, by=names, with_derivatives=True, **options)
    assert found.derivatives is not None
    masses = motion_dynamics(robot, poses, by=names, payloads=payloads, **options)
    reflected, described = (
        np.einsum("...um,u,...un->...mn", found.values, drive_values(robot, "armature", given), found.values)
        for given in (armature, None)
    )
    return Transmission(
        joints=names,
        drives=drives,
        poses=poses,
        asked=frozen(asked),
        jacobian=found.values,
        jacobian_derivatives=found.derivatives,
        rotor_inertia=frozen(reflected),
        inertia=frozen(masses.inertia - described + reflected),
        weight=masses.weight,
        effort=drive_values(robot, "effort", effort),
        speed=drive_values(robot, "speed", speed),
    )


def drive_values(robot: Robot, name: Literal["effort", "speed", "armature"], given: Limit = None) -> Vector:
    """Return one nonnegative number for each drive: those given, or else those described, shape=(u,).

    Efforts and speeds that are not described are infinite. A described effort is the least of the joint's and of what
    its actuators give: their force ranges, and the control ranges of motors times their gains, times the gears.

    Raises:
        InvalidValueError: a number is negative or not finite, or a name is that of no drive.
    """
    drives, model = robot.actuated_joints, robot.model
    described = {"effort": model.upperEffortLimit, "speed": model.upperVelocityLimit, "armature": model.armature}[name]
    values = np.array(described)[robot.actuated_indices]
    if name != "armature":
        values[values == 0.0] = np.inf  # in descriptions, 0 stands for unknown
    if name == "effort":
        values = np.minimum(values, _actuator_efforts(robot))
    if isinstance(given, Mapping):
        for drive, value in given.items():
            if drive not in drives:
                raise InvalidValueError(name, drive, f"one of the drives {', '.join(drives)}")
            values[drives.index(drive)] = finite_array(f"{name} of {drive}", value, ())
    elif given is not None:
        numbers = finite_array(name, given, (), (len(drives),))
        values[:] = numbers
    if not (values >= 0.0).all():
        raise InvalidValueError(name, values.tolist(), "no negative numbers")
    return frozen(np.where(values < _UNLIMITED, values, np.inf))


def _actuator_efforts(robot: Robot) -> Vector:
    """Return what the described actuators give at each driven joint, shape=(u,) [N m, N]; infinite if unknown."""
    found = np.full(len(robot.actuated_joints), np.inf)
    for k, joint in enumerate(robot.actuated_joints):
        efforts = []
        for drive in robot.description.drives:
            if drive.joint == joint:
                ranges = [(drive.force_range, 1.0)]
                if drive.kind == "motor":
                    gain = 1.0 if drive.control_gain is None else abs(drive.control_gain)
                    ranges.append((drive.control_range, gain))
                # of a range to one side only, this says nothing about the other
                ends = [
                    factor * min(-ends[0], ends[1])
                    for ends, factor in ranges
                    if ends is not None and ends[0] < 0.0 < ends[1]
                ]
                efforts.append(abs(drive.gear) * min(ends, default=np.inf))
        if efforts and sum(efforts) > 0.0:
            found[k] = sum(efforts)
    return found


def described_gains(robot: Robot) -> dict[str, Vector | None]:
    """Return the gains "kp" and "kd" at the driven joints, shape=(u,), as described; None if a drive has none."""
    by_joint = {drive.joint: drive for drive in robot.description.drives if drive.kind != "motor"}
    drives = [by_joint[name] for name in robot.actuated_joints if name in by_joint]
    found: dict[str, Vector | None] = {"kp": None, "kd": None}
    for name, key in (("kp", "proportional_gain"), ("kd", "derivative_gain")):
        gains = [drive.gear**2 * getattr(drive, key) for drive in drives if getattr(drive, key) is not None]
        if gains and len(gains) == len(robot.actuated_joints):
            found[name] = np.array(gains)
    return found


def _pure(polytopes: Polytopes, count: int) -> Array:
    axes = [np.eye(count)[k] for k in range(count)]
    ends = [np.minimum(polytopes.extent(axis), polytopes.extent(-axis)) for axis in axes]
    return frozen(np.stack(ends, axis=-1))


def _singular_values(matrices: Array) -> Array:
    values = np.full((*matrices.shape[:-2], min(matrices.shape[-2:])), np.nan)
    known = np.isfinite(matrices).all(axis=(-2, -1))
    values[known] = np.linalg.svd(matrices[known], compute_uv=False)
    return values
