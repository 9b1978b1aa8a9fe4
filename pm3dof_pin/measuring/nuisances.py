"""Nuisance parameters of measurements: the instrument's frame, target positions, drift, approach direction.

Each nuisance parameter acts as a small apparent motion of the tool, like a geometric error. So measurements are one
function of machine parameters p and nuisance parameters y, with one stacked derivative [S, N],

    dx_seen = S dp + N dy,

which is the basis of identification, rank, covariance and plan.

============  =====================================================  ==================================================
frame         the instrument has a frame of its own                  6: the base in this frame, known only from data
stations      rows were seen from places of their own                6 for each, as for the frame
targets       points off the tool point, known to `target_sigma`     3 for each, in the tool's axes
tool point    the tool point itself, known to `tool_point_sigma`     3, in the tool's axes
datums        rows measured against spheres, planes, lines,          3 to 6 for each, its placement, from the data only
              sockets, cameras of unknown placement
drift         rows have times                                        a motion of the base and of each drive's zero, [m]
                                                                     and [rad] from the first row to the last
hysteresis    rows have approaches                                   for each drive, from one direction to the other
homings       rows were measured before drives were homed anew       for each of them, the zero of each drive then
encoders      passive joints have encoders                           the zero of each, known to ENCODER_ZERO
============  =====================================================  ==================================================
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.datum import Datum
from pm3dof_pin.measuring.instrument import ENCODER_ZERO
from pm3dof_pin.measuring.measurements import Measurements, with_joints
from pm3dof_pin.measuring.registration import AT_THE_BASE
from pm3dof_pin.typing import Array, Indices, Mask

_FRAME_SCALE = {"m": 1e-3, "rad": 1e-3}
_FRAME_SIGMA = 1e3  # in these units: uninformative
_DRIFT_SIGMA = {"m": 1e-4, "rad": 2e-4}  # from the first row to the last
_HYSTERESIS_SIGMA = {"m": 1e-4, "rad": 2e-4}  # of a drive that slides, turns
_TWIST = {"tx": "m", "ty": "m", "tz": "m", "rx": "rad", "ry": "rad", "rz": "rad"}


@dataclass(frozen=True, eq=False)
class NuisancePart(ABC):
    """One kind of nuisance parameters. Rows of measurements without its data do not depend on it."""

    kind: str  #: "frame", "targets" ...
    names: tuple[str, ...]  #: names of the parameters, usually `kind.axis`
    units: tuple[str, ...]  #: of each, "m" or "rad"
    scales: Array  #: scales of the parameters, shape=(k,) [m, rad]
    sigma: float = 1.0  #: prior standard deviation, in these scales

    @abstractmethod
    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """Return the apparent motion of the tool by each parameter, shape=(n, 6, k), or (n, 6 + joints, k).

        Poses are the machine's at each row; `drives` is the motion of the tool, and of the joints with encoders, by the
        drives' joints, shape=(n, 6 or 6 + joints, commands).
        """

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """Return measurements without the effect of parameter values, shape=(k,) [m, rad]; see :meth:`motions`."""
        return measurements.without_motions(poses, self.motions(measurements, poses, drives) @ values)


class _InstrumentFrame(NuisancePart):
    """Correction of the registration: a twist in base axes that moves everything."""

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        # datums are placed relative to the base
        return _rigid_motions(poses) * ~measurements.on_datums[:, None, None]

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        return measurements.in_moved_base(values) if values.any() else measurements


@dataclass(frozen=True, eq=False)
class _StationFrame(NuisancePart):
    """Correction of one station's registration: a twist in base axes that moves everything seen from it."""

    number: int = field(kw_only=True)  #: of the station

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        return _rigid_motions(poses) * self._own(measurements)[:, None, None]

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        own = self._own(measurements)
        return measurements.with_rows_in_axes(own, AT_THE_BASE.moved(np.array(values))) if own.any() else measurements

    def _own(self, measurements: Measurements) -> Mask:
        if measurements.stations is None:
            return np.zeros(len(measurements), dtype=bool)
        return np.asarray((measurements.stations == self.number) & ~measurements.on_datums)


@dataclass(frozen=True, eq=False)
class _PointOffsets(NuisancePart):
    """Corrections of the points on the tool: moving a target is equivalent to shifting the tool."""

    points: Array = field(kw_only=True)  #: in the tool's axes, shape=(points, 3) [m]

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        motions = np.zeros((len(measurements), 6, len(self.points), 3))
        motions[:, :3] = poses.rotations[:, :, None, :] * self._members(measurements)[:, None, :, None]
        return motions.reshape(len(measurements), 6, -1)

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        return measurements.with_points(measurements.points + self._members(measurements) @ values.reshape(-1, 3))

    def _members(self, measurements: Measurements) -> Array:
        """Indicate which point each row sees, 1 or 0, shape=(n, points)."""
        seen = np.isclose(measurements.points[:, None], self.points, rtol=0.0, atol=1e-9).all(axis=2)
        return np.asarray(seen, dtype=float)


@dataclass(frozen=True, eq=False)
class _DatumPlacement(NuisancePart):
    """Correction of a datum's placement, relative to its fit by the machine as described."""

    number: int = field(kw_only=True)  #: of the datum among those of its kind

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        motions = np.zeros((len(measurements), 6, len(self.names)))
        for datum in self._own(measurements):
            motions[:, :3] = datum.apparent_motions(measurements.points_on(poses))
        return motions

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        for datum in self._own(measurements):
            measurements = measurements.with_datum(datum.moved(values))
        return measurements

    def _own(self, measurements: Measurements) -> list[Datum]:
        return [datum for datum in measurements.datums if (datum.kind.name, datum.number) == (self.kind, self.number)]


@dataclass(frozen=True, eq=False)
class _Drift(NuisancePart):
    """Motion of the base and of the drives' zeros in proportion to time, from the first row to the last."""

    start: float = field(kw_only=True)  #: time of the first row [s]
    duration: float = field(kw_only=True)  #: time to the last row [s]

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        base = with_joints(_rigid_motions(poses), drives.shape[1] - 6)
        times = np.full(1, self.start) if measurements.times is None else measurements.times
        # from -1/2 to 1/2, so that the machine at the middle of the time is identified
        parts = np.broadcast_to((times - self.start) / self.duration - 0.5, len(measurements))
        return np.concatenate([base, drives], axis=2) * parts[:, None, None]


class _Hysteresis(NuisancePart):
    """Difference of each drive's position between approaches from below and from above."""

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        if measurements.approaches is None:
            return np.zeros_like(drives)
        return np.asarray(0.5 * drives * measurements.approaches[:, None, :])


@dataclass(frozen=True, eq=False)
class _EarlierZeros(NuisancePart):
    """Places of the drives at an earlier homing minus the present ones, at the same readings."""

    number: int = field(kw_only=True)  #: of the homing

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        own = np.zeros(1) if measurements.homings is None else measurements.homings
        return np.asarray(drives * (own == self.number)[:, None, None])


class _EncoderZeros(NuisancePart):
    """Zero of each encoder: its reading minus the joint's coordinate."""

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        return np.tile(np.eye(6 + len(self.names))[:, 6:], (len(poses), 1, 1))


class Nuisances:
    """All nuisance parameters of some measurements, concatenated by kind. Immutable."""

    def __init__(self, parts: Iterable[NuisancePart] = ()) -> None:
        self.parts = tuple(parts)
        self.names = tuple(name for part in self.parts for name in part.names)
        self.units = tuple(unit for part in self.parts for unit in part.units)
        self.scales = frozen(np.concatenate([np.zeros(0), *(part.scales for part in self.parts)]))
        self.sigmas = frozen(np.array([part.sigma for part in self.parts for _ in part.names], dtype=float))

    @classmethod
    def from_measurements(cls, measurements: Measurements, drive_units: tuple[str, ...]) -> Nuisances:
        """Return the nuisance parameters that measurements imply; drives have units "m" or "rad" each."""
        parts: list[NuisancePart] = []
        drives = {f"u{k}": unit for k, unit in enumerate(drive_units, start=1)}
        if measurements.registration is not None:
            parts.append(_InstrumentFrame("frame", *_named("frame", _TWIST, _FRAME_SCALE), _FRAME_SIGMA))
        for number in () if measurements.stations is None else np.setdiff1d(measurements.stations, [0]):
            named = _named(f"station{number}", _TWIST, _FRAME_SCALE)
            parts.append(_StationFrame("stations", *named, _FRAME_SIGMA, number=int(number)))
        points = measurements.points[np.unique(measurements.target_numbers, return_index=True)[1]]
        off = points.any(axis=1)
        labels = [f"target{k}" for k in range(1, int(off.sum()) + 1)]
        if labels and (sigma := measurements.target_sigma) > 0.0:
            parts.append(_PointOffsets("targets", *_positions(labels, sigma), points=frozen(points[off])))
        if not off.all() and (sigma := measurements.tool_point_sigma) > 0.0:
            parts.append(_PointOffsets("tool_point", *_positions(["tool_point"], sigma), points=frozen(points[~off])))
        for datum in measurements.datums:
            units = tuple("rad" if ".r" in name else "m" for name in datum.names)
            scales = np.array([_FRAME_SCALE[unit] for unit in units])
            parts.append(
                _DatumPlacement(datum.kind.name, datum.names, units, scales, _FRAME_SIGMA, number=datum.number)
            )
        times = measurements.times
        if times is not None and np.ptp(times) > 0.0:
            named = _named("drift", {**_TWIST, **drives}, _DRIFT_SIGMA)
            parts.append(_Drift("drift", *named, start=float(times.min()), duration=float(np.ptp(times))))
        if measurements.approaches is not None and measurements.approaches.any():
            parts.append(_Hysteresis("hysteresis", *_named("hysteresis", drives, _HYSTERESIS_SIGMA)))
        for number in () if measurements.homings is None else np.setdiff1d(measurements.homings, [0]):
            named = _named(f"homing{number}", drives, _FRAME_SCALE)
            parts.append(_EarlierZeros("homings", *named, _FRAME_SIGMA, number=int(number)))
        if measurements.joints:
            parts.append(_EncoderZeros("encoders", *_named("encoder", measurements.joints, ENCODER_ZERO)))
        return cls(parts)

    def __len__(self) -> int:
        return len(self.names)

    def columns(self, kind: str) -> Indices:
        """Return the indices of the parameters of a kind; none if there are none."""
        kinds = [part.kind for part in self.parts for _ in part.names]
        return np.flatnonzero([entry == kind for entry in kinds])

    def datum_map(self, *, of_points: bool = True) -> Array:
        """Return the effect of the parameters on base and tool as the measurements define them, shape=(12, parameters).

        The base is that of the instrument's frame, [v; omega]; the tool is at the mean of the points seen, [v; omega]
        in its own axes. A shift or rotation common to all points is equivalent to another tool. If it is not that of
        the points, it is where the machine's parameters have it: no parameter here moves it.
        """
        found = np.zeros((12, len(self)))
        frame, targets = self.columns("frame"), self.columns("targets")
        found[np.arange(len(frame)), frame] = 1.0
        for part in self.parts:
            if of_points and isinstance(part, _PointOffsets) and (part.kind == "targets" or not targets.size):
                rows = np.concatenate([np.hstack([np.eye(3), -_cross(point)]) for point in part.points])
                found[6:, self.columns(part.kind)] = np.linalg.pinv(rows)
        return found

    def motions(self, measurements: Measurements, poses: Poses, drives: Array) -> Array:
        """Return the motion of tool and encoders by all parameters, shape=(n, 6 + joints, k)."""
        blocks = [
            np.zeros((len(measurements), 6, 0)),
            *(part.motions(measurements, poses, drives) for part in self.parts),
        ]
        return np.concatenate([with_joints(block, len(measurements.joints)) for block in blocks], axis=2)

    def removed(self, measurements: Measurements, poses: Poses, drives: Array, values: Array) -> Measurements:
        """Return measurements without the effect of all parameters, given their values, shape=(k,) [m, rad]."""
        ends = np.cumsum([len(part.names) for part in self.parts])
        for part, own in zip(self.parts, np.split(values, ends[:-1]) if self.parts else (), strict=True):
            measurements = part.removed(measurements, poses, drives, own)
        return measurements


_Named = tuple[tuple[str, ...], tuple[str, ...], Array]


def _named(prefix: str, units: Mapping[str, str], scales: Mapping[str, float]) -> _Named:
    """Return names, units and scales of parameters; the unit determines the scale."""
    return (
        tuple(f"{prefix}.{name}" for name in units),
        (*units.values(),),
        np.array([scales[u] for u in units.values()]),
    )


def _positions(labels: Iterable[str], scale: float) -> _Named:
    """Return names, units and scales of the coordinates of points."""
    names = tuple(f"{label}.{axis}" for label in labels for axis in "xyz")
    return names, ("m",) * len(names), np.full(len(names), scale)


def _rigid_motions(poses: Poses) -> Array:
    """Return the tool's motion by a twist [v; omega] of everything at the base's origin, shape=(n, 6, 6)."""
    motions = np.tile(np.eye(6), (len(poses), 1, 1))
    x, y, z = poses.positions.T
    motions[:, 0, 4], motions[:, 0, 5] = z, -y
    motions[:, 1, 3], motions[:, 1, 5] = -z, x
    motions[:, 2, 3], motions[:, 2, 4] = y, -x
    return motions


def datum_motions(poses: Poses) -> Array:
    """Return the tool's motion at n poses by motions of the base, then of the tool on its link, shape=(n, 6, 12)."""
    own = np.zeros((len(poses), 6, 6))
    own[:, :3, :3] = own[:, 3:, 3:] = poses.rotations
    return np.concatenate([_rigid_motions(poses), own], axis=2)


def seen_datum_map(nuisances: Nuisances, machine: Array, poses: Poses, weights: Array, covariance: Array) -> Array:
    """Return :meth:`Nuisances.datum_map` with the tool as the points show it where it is known better so.

    Points that are known worse than the parts of the machine, such as the one stylus of a probe, would make the tool
    less certain than it is where the parameters have it.

    Args:
        nuisances: of the measurements.
        machine: the tool's motions by the machine's parameters, shape=(n, 6, k) [m, rad].
        poses: those over which it is judged, shape=(n,).
        weights: of the tip error, shape=(6,).
        covariance: of the machine's parameters and the nuisances, shape=(k + nuisances, same).
    """
    shown, base_and_tool = nuisances.datum_map(), datum_motions(poses)
    described = nuisances.datum_map(of_points=False)

    def square(datum: Array) -> float:
        effects = np.concatenate([machine, base_and_tool @ datum], axis=2) * weights[:, None]
        flat = effects.reshape(-1, effects.shape[2])
        return float(np.sum((flat.T @ flat) * covariance))

    return shown if square(shown) <= square(described) else described


def _cross(vector: Array) -> Array:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
