"""The numbers of a serial model of joints that closed loops drive: one constant for what depends on the pose.

A serial model has one effort, velocity, armature and pair of gains for each joint. Over a box of poses each of these is
a range; the constant that is least wrong has the smallest greatest relative error, 2 a b / (a + b) of the ends a and b.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, require_choice
from pm3dof_pin.capability.transmission import Transmission
from pm3dof_pin.exceptions import SingularConfigurationError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array, Mask, Vector

Choice: TypeAlias = Literal["least-wrong", "worst"]
"""Which constant stands for a range: the one with the least relative error, or the cautious end."""


@dataclass(frozen=True, eq=False)
class Spread:
    """A quantity of each joint over a box of poses."""

    least: Vector  #: shape=(m,)
    greatest: Vector  #: shape=(m,)
    cautious: Literal["least", "greatest"]  #: the end that promises nothing that the machine cannot do

    @classmethod
    def over(cls, values: Array, cautious: Literal["least", "greatest"]) -> Spread:
        """Take the range of values at poses, shape=(..., m); those that are NaN are left out."""
        rows = values.reshape(-1, values.shape[-1])
        return cls(frozen(np.nanmin(rows, axis=0)), frozen(np.nanmax(rows, axis=0)), cautious)

    @property
    def least_wrong(self) -> Vector:
        """The constant with the smallest greatest relative error, shape=(m,)."""
        low, high = self.least, self.greatest
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(low == high, low, 2.0 * low * high / (low + high))

    @property
    def error(self) -> Vector:
        """The greatest relative error of :attr:`least_wrong`, shape=(m,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(
                self.least == self.greatest, 0.0, (self.greatest - self.least) / (self.greatest + self.least)
            )

    def chosen(self, choice: Choice) -> Vector:
        """Return the constant that stands for the range, shape=(m,)."""
        require_choice("choice", choice, Choice)
        if choice == "least-wrong":
            return self.least_wrong
        return self.least if self.cautious == "least" else self.greatest


@dataclass(frozen=True, eq=False)
class SerialModel:
    """What to type into a serial model, and by how much it is wrong over a box of poses."""

    joints: tuple[str, ...]  #: names of the m joints
    units: tuple[str, ...]  #: "m" or "rad" of each
    lower: Vector  #: ends of the box, shape=(m,) [rad, m]
    upper: Vector  #: shape=(m,) [rad, m]
    unreached: float  #: share of the box's poses out of reach or beyond limits of the closed mechanism
    #: greatest factor by which the box shrinks towards its centre such that all of its poses are within limits
    reached_scale: float
    armature: Spread  #: inertia of the rotors at each joint, the diagonal of G^T I_m G [kg m^2, kg]
    inertia: Spread  #: of all moving bodies and rotors [kg m^2, kg]
    #: greatest magnitude over the box of an off-diagonal entry of G^T I_m G, relative to the diagonal's geometric mean
    coupling: float
    #: greatest pure torque beyond the weight [N m, N], 0 where the drives cannot hold it; None if efforts are unknown
    torque: Spread | None
    effort: Spread | None  #: the same, what holds the weight included: the effort limit of a serial model
    unit_torque: Spread  #: the same in multiples of the drives' effort, without gravity
    speed: Spread | None  #: greatest speed [rad/s, m/s]; None if unknown
    gains: Mapping[str, Spread]  #: "kp" and "kd" at the joints [N m/rad, N m s/rad]; empty if none are given
    distance_to_singularity: float  #: least over the box


def serial_model(
    transmission: Transmission, *, kp: ArrayLike | None = None, kd: ArrayLike | None = None
) -> SerialModel:
    """Reduce the transmission over a grid of the joints to constants; of poses within limits only.

    Args:
        transmission: over a grid, shape=(n1, ..., nm), made with `on_failure="nan"`.
        kp: proportional gains of the drives, shape=(u,) or one for all [N m/rad, N/m].
        kd: derivative gains of the drives [N m s/rad, N s/m].

    Raises:
        UnreachablePoseError: no pose of the grid is within limits.
        SingularConfigurationError: joints and drives determine each other at none of those that are.
        InvalidValueError: the poses are not a grid over the joints, in their order.
    """
    count, axes = len(transmission.joints), transmission.axes
    within = transmission.poses.within_limits & np.isfinite(transmission.jacobian).all(axis=(-2, -1))
    if not within.any():
        if transmission.poses.within_limits.any():
            raise SingularConfigurationError(
                f"{transmission.poses.robot.name}: {', '.join(transmission.joints)} and the drives "
                f"{', '.join(transmission.drives)} determine each other at no pose of the box"
            )
        raise UnreachablePoseError(f"{transmission.poses.robot.name}: {_reason(transmission.poses)}")
    rotor = _at(transmission.rotor_inertia, within)
    diagonal = np.einsum("...ii->...i", rotor)
    with np.errstate(invalid="ignore"):  # rotors without inertia
        off = np.abs(rotor) / np.sqrt(diagonal[..., :, None] * diagonal[..., None, :])
    off[..., np.arange(count), np.arange(count)] = 0.0
    known = {"effort": np.isfinite(transmission.effort).all(), "speed": np.isfinite(transmission.speed).all()}
    gains = {"kp": kp, "kd": kd}
    return SerialModel(
        joints=transmission.joints,
        units=tuple(c.unit for c in transmission.poses.robot.coordinates),
        lower=frozen(np.array([axis.min() for axis in axes])),
        upper=frozen(np.array([axis.max() for axis in axes])),
        unreached=float(1.0 - within.mean()),
        reached_scale=_reached_scale(within),
        armature=Spread.over(diagonal, "greatest"),
        inertia=Spread.over(np.einsum("...ii->...i", _at(transmission.inertia, within)), "greatest"),
        coupling=float(np.nan_to_num(off).max(initial=0.0)),
        torque=Spread.over(np.nan_to_num(_at(transmission.pure_torques, within)), "least") if known["effort"] else None,
        effort=Spread.over(_at(transmission.pure_total_torques, within), "least") if known["effort"] else None,
        unit_torque=Spread.over(_at(transmission.unit_pure_torques, within), "least"),
        speed=Spread.over(_at(transmission.pure_speeds, within), "least") if known["speed"] else None,
        gains={
            name: Spread.over(np.einsum("...ii->...i", _at(transmission.joint_gains(gain), within)), "least")
            for name, gain in gains.items()
            if gain is not None
        },
        distance_to_singularity=float(_at(transmission.distance_to_singularity, within).min()),
    )


def _reason(poses: Poses) -> str:
    """Say why no pose of a box is within limits."""
    words, solved = "no pose of the box is within limits", np.argwhere(poses.solved)
    if not len(solved):
        return f"{words}: all are out of reach"
    broken = poses[tuple(solved[len(solved) // 2])].configuration().violated_limits()
    listed = ", ".join(f"{b.name} at {b.value:.4g}, limits {b.lower:.4g} to {b.upper:.4g}" for b in broken[:3])
    outside = poses.solved.size - len(solved)
    return f"{words}: {outside} of {poses.solved.size} are out of reach, others break limits, as {listed} (m, rad)"


def _at(values: Array, within: Mask) -> Array:
    return np.asarray(values[within])


def _reached_scale(within: Mask) -> float:
    """Return the greatest share of the grid, about its centre, all of whose points are within limits."""
    axes = [np.abs(np.linspace(-1.0, 1.0, size)) if size > 1 else np.zeros(1) for size in within.shape]
    distance = np.max(np.stack(np.meshgrid(*axes, indexing="ij")), axis=0)
    if within.all():
        return 1.0
    first = distance[~within].min()
    inside = distance[distance < first - 1e-12]
    return float(inside.max(initial=0.0)) if inside.size else 0.0
