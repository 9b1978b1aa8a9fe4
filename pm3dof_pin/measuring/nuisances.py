"""What measurements depend on besides the machine: where the instrument stands and targets sit, drift, direction.

Each nuisance parameter is a small motion of the tool that is seen, like a geometric error. So measurements are one
function of machine parameters p and nuisance parameters y, with one stacked derivative [S, N],

    dx_seen = S dp + N dy,

from which identification, rank, covariance and plan all start.

============  =====================================================  ==================================================
frame         the instrument has a frame of its own                  6: where the base is in it, known only by the data
targets       points off the tool point, known to `target_sigma`     3 for each, in the tool's axes
tool point    the tool point itself, known to `tool_point_sigma`     3, in the tool's axes
spheres       surfaces of spheres were touched                       3 for each, its centre, known only by the data
drift         rows have times                                        a motion of the base and of each drive's zero, [m]
                                                                     and [rad] from the first row to the last
hysteresis    rows have approaches                                   for each drive, from one direction to the other
encoders      passive joints have encoders                           the zero of each, known to ENCODER_ZERO
============  =====================================================  ==================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.encoders import ENCODER_ZERO
from pm3dof_pin.measuring.measurements import Measurements, with_joints
from pm3dof_pin.typing import Array, Indices

TARGET_SIGMA = 1e-3
"""How well targets are known where nobody has measured them [m]."""

FRAME_SCALE = (1e-3, 1e-3)
"""Units in which an instrument's frame is counted [m, rad]."""

_FRAME_SIGMA = 1e3  # in these units: not known beforehand at all
_DRIFT_SIGMA = (1e-4, 2e-4)  # from the first row to the last [m, rad]
_HYSTERESIS_SIGMA = (1e-4, 2e-4)  # of a drive that slides, turns [m, rad]
_AXES = ("x", "y", "z")
_TWIST = ("tx", "ty", "tz", "rx", "ry", "rz")


class Nuisance(Protocol):
    """One kind of nuisance parameters."""

    @property
    def kind(self) -> str:
        """Return "frame", "targets" ..."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each, "m" or "rad"."""
        ...

    @property
    def scales(self) -> Array:
        """Scales in which they are counted, shape=(k,) [m, rad]."""
        ...

    @property
    def sigmas(self) -> Array:
        """Standard deviations beforehand, in these scales, shape=(k,)."""
        ...

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """Return the motion of the tool that is seen by each parameter, shape=(n, 6, k), or (n, 6 + joints, k).

        Poses are the machine's at each row; `drives` the motion of the tool, and of the joints with encoders, by the
        joints of the drives, shape=(n, 6 or 6 + joints, commands).
        """
        ...

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """Return measurements without what parameters of some values, shape=(k,) [m, rad], did; see :meth:`motions`."""
        ...


@dataclass(frozen=True, eq=False)
class _InstrumentFrame:
    """Where the base is, beyond the registration: a twist in the base's axes."""

    kind = "frame"
    names = tuple(f"frame.{name}" for name in _TWIST)
    units = ("m", "m", "m", "rad", "rad", "rad")
    scales = frozen(np.repeat(FRAME_SCALE, 3))
    sigmas = frozen(np.full(6, _FRAME_SIGMA))

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """See :class:`Nuisance`: everything moves with the base."""
        return _rigid_motions(poses)

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """See :class:`Nuisance`."""
        return measurements.in_moved_base(values) if values.any() else measurements


@dataclass(frozen=True, eq=False)
class _PointOffsets:
    """Where points sit on the tool, beyond what the measurements say, in the tool's axes."""

    points: Array  #: the points, shape=(k, 3) [m]
    sigma: float  #: how well they are known [m]
    kind: str  #: "targets" or "tool_point"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        labels = [f"target{k}" for k in range(1, len(self.points) + 1)] if self.kind == "targets" else [self.kind]
        return tuple(f"{label}.{axis}" for label in labels for axis in _AXES)

    @property
    def units(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        return ("m",) * len(self.names)

    @property
    def scales(self) -> Array:
        """See :class:`Nuisance`."""
        return np.full(len(self.names), self.sigma)

    @property
    def sigmas(self) -> Array:
        """See :class:`Nuisance`."""
        return np.ones(len(self.names))

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """See :class:`Nuisance`: a target elsewhere on the tool is the tool shifted."""
        motions = np.zeros((len(measurements), 6, len(self.points), 3))
        motions[:, :3] = poses.rotations[:, :, None, :] * self._members(measurements)[:, None, :, None]
        return motions.reshape(len(measurements), 6, -1)

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """See :class:`Nuisance`."""
        return measurements.with_points(measurements.points + self._members(measurements) @ values.reshape(-1, 3))

    def _members(self, measurements: Measurements) -> Array:
        """Tell which point a row sees, 1 or 0, shape=(n, k)."""
        return np.array(
            np.all(np.isclose(measurements.points[:, None], self.points, rtol=0.0, atol=1e-9), axis=2), float
        )


@dataclass(frozen=True, eq=False)
class _SphereCentres:
    """Where the centres of touched spheres are, beyond where the machine as described has them."""

    numbers: Indices  #: the spheres, shape=(k,)
    kind = "spheres"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        return tuple(f"sphere{k}.{axis}" for k in self.numbers for axis in _AXES)

    @property
    def units(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        return ("m",) * len(self.names)

    @property
    def scales(self) -> Array:
        """See :class:`Nuisance`."""
        return np.full(len(self.names), FRAME_SCALE[0])

    @property
    def sigmas(self) -> Array:
        """See :class:`Nuisance`."""
        return np.full(len(self.names), _FRAME_SIGMA)

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """See :class:`Nuisance`: a centre elsewhere is the tool shifted the other way."""
        motions = np.zeros((len(measurements), 6, len(self.numbers), 3))
        motions[:, :3] = -np.eye(3)[:, None, :] * self._members(measurements)[:, None, :, None]
        return motions.reshape(len(measurements), 6, -1)

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """See :class:`Nuisance`."""
        if measurements.origins is None:
            return measurements
        return measurements.with_origins(measurements.origins + self._members(measurements) @ values.reshape(-1, 3))

    def _members(self, measurements: Measurements) -> Array:
        """Tell which sphere a row touches, 1 or 0, shape=(n, k)."""
        if measurements.spheres is None:
            return np.zeros((len(measurements), len(self.numbers)))
        return np.asarray(measurements.spheres[:, None] == self.numbers, float)


@dataclass(frozen=True, eq=False)
class _Drift:
    """Motion of the base and of the drives' zeros in proportion to time, from the first row to the last."""

    start: float  #: time of the first row [s]
    duration: float  #: to the last [s]
    drive_units: tuple[str, ...]  #: "m" or "rad" of each drive's joint
    kind = "drift"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        drives = [f"drift.u{k}" for k in range(1, len(self.drive_units) + 1)]
        return (*(f"drift.{name}" for name in _TWIST), *drives)

    @property
    def units(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        return (*_InstrumentFrame.units, *self.drive_units)

    @property
    def scales(self) -> Array:
        """See :class:`Nuisance`."""
        return np.array([_DRIFT_SIGMA[unit == "rad"] for unit in self.units])

    @property
    def sigmas(self) -> Array:
        """See :class:`Nuisance`."""
        return np.ones(len(self.units))

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """See :class:`Nuisance`."""
        base = with_joints(_rigid_motions(poses), drives.shape[1] - 6)
        return np.concatenate([base, drives], axis=2) * self._parts(measurements)[:, None, None]

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """See :class:`Nuisance`."""
        return measurements.without_motions(poses, self.motions(measurements, poses, drives) @ values)

    def _parts(self, measurements: Measurements) -> Array:
        """Return times from -1/2 to 1/2, so that what is identified is the machine in the middle."""
        times = self.start if measurements.times is None else measurements.times
        return np.broadcast_to((times - self.start) / self.duration - 0.5, len(measurements))


@dataclass(frozen=True, eq=False)
class _Hysteresis:
    """By how much each drive stands elsewhere when it comes from below, less when it comes from above."""

    drive_units: tuple[str, ...]  #: "m" or "rad" of each drive's joint
    kind = "hysteresis"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        return tuple(f"hysteresis.u{k}" for k in range(1, len(self.drive_units) + 1))

    @property
    def units(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        return self.drive_units

    @property
    def scales(self) -> Array:
        """See :class:`Nuisance`."""
        return np.array([_HYSTERESIS_SIGMA[unit == "rad"] for unit in self.units])

    @property
    def sigmas(self) -> Array:
        """See :class:`Nuisance`."""
        return np.ones(len(self.units))

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """See :class:`Nuisance`."""
        if measurements.approaches is None:
            return np.zeros_like(drives)
        return np.asarray(0.5 * drives * measurements.approaches[:, None, :])

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """See :class:`Nuisance`."""
        return measurements.without_motions(poses, self.motions(measurements, poses, drives) @ values)


@dataclass(frozen=True, eq=False)
class _EncoderZeros:
    """By how much each encoder shows more than its joint's coordinate."""

    joints: tuple[str, ...]
    units: tuple[str, ...]  #: "m" or "rad" of each
    kind = "encoders"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """See :class:`Nuisance`."""
        return tuple(f"encoder.{joint}" for joint in self.joints)

    @property
    def scales(self) -> Array:
        """See :class:`Nuisance`."""
        return np.array([ENCODER_ZERO[unit] for unit in self.units])

    @property
    def sigmas(self) -> Array:
        """See :class:`Nuisance`."""
        return np.ones(len(self.units))

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """See :class:`Nuisance`: the joint seems to stand elsewhere."""
        motions = np.zeros((len(poses), 6 + len(self.joints), len(self.joints)))
        motions[:, 6:] = np.eye(len(self.joints))
        return motions

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """See :class:`Nuisance`."""
        return measurements.without_motions(poses, self.motions(measurements, poses, drives) @ values)


class Nuisances:
    """All nuisance parameters of some measurements, by kind, in one row. Not to be changed once made."""

    def __init__(self, parts: tuple[Nuisance, ...] = ()) -> None:
        self.parts = parts
        self.names = tuple(name for part in parts for name in part.names)
        self.units = tuple(unit for part in parts for unit in part.units)
        self.scales = frozen(np.concatenate([np.zeros(0), *(part.scales for part in parts)]))
        self.sigmas = frozen(np.concatenate([np.zeros(0), *(part.sigmas for part in parts)]))

    @classmethod
    def of(cls, measurements: Measurements, drive_units: tuple[str, ...]) -> Nuisances:
        """Return what measurements depend on, as they say themselves; drives have units "m" or "rad" each."""
        parts: list[Nuisance] = []
        if measurements.registration is not None:
            parts.append(_InstrumentFrame())
        points = measurements.points[np.unique(measurements.target_numbers, return_index=True)[1]]
        off = points.any(axis=1)
        for kind, chosen, sigma in (
            ("targets", points[off], measurements.target_sigma),
            ("tool_point", points[~off], measurements.tool_point_sigma),
        ):
            if len(chosen) and sigma > 0.0:
                parts.append(_PointOffsets(frozen(chosen), sigma, kind))
        if measurements.spheres is not None:
            parts.append(_SphereCentres(np.setdiff1d(measurements.spheres, [-1])))
        times = measurements.times
        if times is not None and np.ptp(times) > 0.0:
            parts.append(_Drift(float(times.min()), float(np.ptp(times)), drive_units))
        if measurements.approaches is not None and measurements.approaches.any():
            parts.append(_Hysteresis(drive_units))
        if measurements.joints:
            parts.append(_EncoderZeros(tuple(measurements.joints), tuple(measurements.joints.values())))
        return cls(tuple(parts))

    def __len__(self) -> int:
        return len(self.names)

    def columns(self, kind: str) -> Indices:
        """Return the indices of the parameters of a kind; none if there are none."""
        kinds = [part.kind for part in self.parts for _ in part.names]
        return np.flatnonzero([entry == kind for entry in kinds])

    def datum_map(self) -> Array:
        """Return what the parameters do to base and tool as the measurements define them, shape=(12, parameters).

        The base is where the instrument's frame has it, [v; omega]; the tool sits amid the points seen, [v; omega] in
        its own axes. A shift or turn common to all points cannot be told from another tool.
        """
        found = np.zeros((12, len(self)))
        frame, targets = self.columns("frame"), self.columns("targets")
        found[np.arange(len(frame)), frame] = 1.0
        for part in self.parts:
            if isinstance(part, _PointOffsets) and (part.kind == "targets" or not targets.size):
                rows = np.concatenate([np.hstack([np.eye(3), -_cross(point)]) for point in part.points])
                found[6:, self.columns(part.kind)] = np.linalg.pinv(rows)
        return found

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """Return the motion of tool and encoders by all parameters, shape=(n, 6 + joints, k); see :class:`Nuisance`."""
        blocks = [
            np.zeros((len(measurements), 6, 0)),
            *(part.motions(measurements, poses, drives) for part in self.parts),
        ]
        return np.concatenate([with_joints(block, len(measurements.joints)) for block in blocks], axis=2)

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """Return measurements without what all of it did; see :meth:`Nuisance.removed`."""
        ends = np.cumsum([len(part.names) for part in self.parts])
        for part, own in zip(self.parts, np.split(values, ends[:-1]) if self.parts else (), strict=True):
            measurements = part.removed(measurements, poses, drives, own)
        return measurements


def _rigid_motions(poses: Poses) -> Array:
    """Return how the tool moves with a twist [v; omega] of everything at the base's origin, shape=(n, 6, 6)."""
    motions = np.tile(np.eye(6), (len(poses), 1, 1))
    x, y, z = poses.positions.T
    motions[:, 0, 4], motions[:, 0, 5] = z, -y
    motions[:, 1, 3], motions[:, 1, 5] = -z, x
    motions[:, 2, 3], motions[:, 2, 4] = y, -x
    return motions


def datum_motions(poses: Poses) -> Array:
    """Return how the tool moves at n poses with its base, then with its place on its last link, shape=(n, 6, 12)."""
    own = np.zeros((len(poses), 6, 6))
    own[:, :3, :3] = own[:, 3:, 3:] = poses.rotations
    return np.concatenate([_rigid_motions(poses), own], axis=2)


def _cross(vector: Array) -> Array:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
