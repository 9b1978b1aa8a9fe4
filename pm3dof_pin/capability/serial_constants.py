"""The constants of a tree that stands for a closed robot: limits, inertia, losses and gains of its joints.

A serial model has the bodies that its joints carry; rotors and the bodies of the loops are its armature, the closed
robot's inertia at a joint less that of the tree. Losses of the drives, with rates G times those of the joints, are
G^T D G and |G|^T f; efforts and speeds are the greatest about each joint alone, which all joints together have a share
of only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen
from pm3dof_pin.capability.serial_model import Choice, SerialModel, Spread, serial_model
from pm3dof_pin.capability.transmission import Transmission
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.typing import Array, Vector

_CAUTIOUS: dict[str, Literal["least", "greatest"]] = {
    "armature": "greatest",
    "effort": "least",
    "velocity": "least",
    "damping": "greatest",
    "friction": "greatest",
    "kp": "least",
    "kd": "least",
}
UNITS: Mapping[str, tuple[str, str]] = {
    "armature": ("kg", "kg m²"),
    "effort": ("N", "N m"),
    "velocity": ("m/s", "rad/s"),
    "damping": ("N s/m", "N m s/rad"),
    "friction": ("N", "N m"),
    "kp": ("N/m", "N m/rad"),
    "kd": ("N s/m", "N m s/rad"),
}
"""Units of the constants, along and about an axis."""


@dataclass(frozen=True, eq=False)
class SerialConstants:
    """What to type for each of m joints of a serial model."""

    model: SerialModel  #: the ranges over the box
    drives: tuple[str, ...]  #: names of the closed robot's actuated joints
    choice: Choice | Literal["at"]  #: which of a range was chosen; "at" for those at one pose
    at: Vector | None  #: that pose, shape=(m,) [rad, m]
    lower: Vector  #: ends of the box all of whose poses are reached, shape=(m,) [rad, m]
    upper: Vector  #: shape=(m,) [rad, m]
    #: by name, shape=(m,): armature, effort, velocity, damping, friction, kp, kd; those that are unknown are left out
    values: Mapping[str, Vector]
    spreads: Mapping[str, Spread]  #: the same over the box
    #: accelerations of the tree with these constants by those of the closed robot, from rest under a torque about one
    #: joint alone and without weight; None of bodies without mass
    accelerations: Spread | None
    #: share of "effort" and "velocity" that is left over the whole box if all joints need theirs at once
    together: Mapping[str, float]

    @property
    def errors(self) -> dict[str, Vector]:
        """Greatest relative error over the box of each of :attr:`values`, shape=(m,)."""
        return {name: _error(value, self.spreads[name]) for name, value in self.values.items()}


def serial_constants(
    box: Transmission,
    tree: Robot,
    *,
    choice: Choice = "least-wrong",
    at: Transmission | None = None,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> SerialConstants:
    """Choose the constants of a tree that stands for a closed robot over a box of its joints.

    Args:
        box: the transmission over a grid of the joints, as for :func:`~.serial_model.serial_model`.
        tree: the serial model, with joints of the same names; its other joints are at home.
        choice: the least wrong, or the worst, which promises nothing that the machine cannot do.
        at: the transmission at one pose, shape=(), whose numbers are taken instead.
        kp: proportional gains of the drives, shape=(u,) or one for all [N m/rad, N/m].
        kd: derivative gains of the drives [N m s/rad, N s/m].

    Raises:
        UnreachablePoseError: no pose of the box is within limits.
        InvalidValueError: the poses are not a grid over the joints.
        JointNotFoundError: the tree lacks one of the joints.
    """
    model = serial_model(box, kp=kp, kd=kd)
    within = box.poses.within_limits & np.isfinite(box.jacobian).all(axis=(-2, -1))
    tree_inertia = _tree_inertia(box, tree)
    over = _numbers(box, tree_inertia, kp, kd)
    spreads = {name: Spread.over(values[within], _CAUTIOUS[name]) for name, values in over.items()}
    if at is None:
        values = {name: spread.chosen(choice) for name, spread in spreads.items()}
    else:
        values = _numbers(at, _tree_inertia(at, tree), kp, kd)
    together = {}
    if "effort" in values:
        together["effort"] = float(np.min(box.total_torques.box_share(values["effort"])[within]))
    if "velocity" in values:
        together["velocity"] = float(np.min(box.speeds.box_share(values["velocity"])[within]))
    middle, half = 0.5 * (model.lower + model.upper), 0.5 * (model.upper - model.lower)
    return SerialConstants(
        model=model,
        drives=box.drives,
        choice=choice if at is None else "at",
        at=None if at is None else at.poses.coordinates,
        lower=frozen(middle - model.reached_scale * half),
        upper=frozen(middle + model.reached_scale * half),
        values={name: frozen(value) for name, value in values.items()},
        spreads=spreads,
        accelerations=_accelerations(tree_inertia[within] + np.diag(values["armature"]), box.inertia[within]),
        together=together,
    )


def _numbers(at: Transmission, tree_inertia: Array, kp: ArrayLike | None, kd: ArrayLike | None) -> dict[str, Array]:
    """Return the numbers of the joints at each pose, by name, shape=(..., m)."""
    robot, rates = at.poses.robot, np.abs(at.jacobian)
    drives = robot.actuated_indices
    damping, friction = (np.array(part)[drives] for part in (robot.model.damping, robot.model.upperDryFrictionLimit))
    found = {"armature": _diagonal(at.inertia - tree_inertia)}
    if np.isfinite(at.effort).all():
        found["effort"] = at.pure_total_torques
    if np.isfinite(at.speed).all():
        found["velocity"] = at.pure_speeds
    if damping.any():
        found["damping"] = np.einsum("...um,u->...m", rates**2, damping)
    if friction.any():
        found["friction"] = np.einsum("...um,u->...m", rates, friction)
    gains = {"kp": kp, "kd": kd}
    return found | {name: _diagonal(at.joint_gains(gain)) for name, gain in gains.items() if gain is not None}


def _tree_inertia(at: Transmission, tree: Robot) -> Array:
    """Return the inertia of a tree at the joints, without their own armature, shape=(..., m, m) [kg m^2, kg]."""
    joints = [tree.single_joint(name) for name in at.joints]
    rates = [joint.v_index for joint in joints]
    data, q = tree.model.createData(), np.array(tree.home.q)
    found = np.full((*at.poses.shape, len(joints), len(joints)), np.nan)
    for index in map(tuple, np.argwhere(np.isfinite(at.poses.coordinates).all(axis=-1))):
        for joint, value in zip(joints, at.poses.coordinates[index], strict=True):
            joint.set_coordinate(q, value)
        upper = np.triu(pin.crba(tree.model, data, q))
        found[index] = (upper + np.triu(upper, 1).T)[np.ix_(rates, rates)]
    return found - np.diag(tree.model.armature[rates])


def _accelerations(tree: Array, closed: Array) -> Spread | None:
    """Return what a torque about each joint alone makes of one inertia by what it makes of the other."""
    if not all((np.linalg.cond(inertia) < 1.0 / ROUNDING).all() for inertia in (tree, closed)):
        return None
    one, other = (_diagonal(np.asarray(np.linalg.inv(inertia), dtype=float)) for inertia in (tree, closed))
    return Spread.over(one / other, "least")


def _diagonal(matrices: Array) -> Array:
    return np.asarray(np.einsum("...ii->...i", matrices))


def _error(value: Vector, spread: Spread) -> Vector:
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = [np.abs(value - end) / np.abs(end) for end in (spread.least, spread.greatest)]
    return np.asarray(np.nan_to_num(np.maximum(*ends), posinf=np.inf))  # 0 for 0
