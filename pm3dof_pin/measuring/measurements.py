"""Measurements of a machine: commands, measured tool poses, and residuals relative to a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.arrays import finite_array, real_array
from pm3dof_pin.errors.pose_error import (
    TIP_LENGTH,
    pose_difference,
    rotation_matrix,
    rotation_vector_rates,
    tip_weights,
)
from pm3dof_pin.exceptions import InvalidValueError, ShapeError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.datum import Datum
from pm3dof_pin.measuring.instrument import Instrument, Measured
from pm3dof_pin.measuring.registration import AT_THE_BASE, Registration, register
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Indices, Mask

_COLUMNS = (
    "commands",
    "positions",
    "rotations",
    "points",
    "times",
    "approaches",
    "origins",
    "readings",
    "stations",
    "homings",
)


@dataclass(frozen=True, eq=False)
class Measurements:
    """Commands and measurements of the tool, row by row: poses, points, single coordinates, distances.

    A coordinate that was not measured has an infinite sigma, and its number is ignored. A row with a distance has only
    that, as its first column: the distance of the point seen from a fixed point, or from the point of another row.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> poses = pm.load("pm3dof").forward([[0.24, 0.24, 0.24], [0.25, 0.24, 0.23]])
        >>> len(pm.Measurements.from_poses(poses.commands, poses.transforms))
        2

    Attributes:
        commands: readings of the drives' counters, shape=(n, number of commands) [m, rad].
        positions: measured positions of the tool point, or of `points`, in the world, shape=(n, 3) [m].
        rotations: orientation of the tool, shape=(n, 3, 3); None if positions only were measured.
        sigmas: noise of each measured coordinate (x, y, z, then about these axes), shape=(n, 6) or (n, 3), then of each
            encoder [m, rad]; infinite if not measured. For a distance it is the first.
        points: the points seen, in the tool's axes from the tool point, shape=(n, 3) [m]; zeros for the tool point.
        conditions: temperatures and loads by the name of their column, shape=(n,) each.
        lines: line of the file of each row, shape=(n,); counted from 2 if there is no file.
        warnings: warnings about the file.
        registration: registration that brought them into base axes; None if they were measured in base axes.
        target_sigma: prior standard deviation of `points` other than the tool point, per coordinate [m]; 0 if known
            exactly.
        tool_point_sigma: the same for the tool point itself, if that is the point seen [m].
        times: when each row was measured, shape=(n,) [s]; None if unknown.
        approaches: direction from which each drive came, +1 or -1, 0 for unknown, shape=(n, number of commands); None
            if unknown.
        distances: the distance measured, NaN in rows without one, shape=(n,) [m]; None if there are none.
        origins: the fixed points, in the world, from which distances are measured, shape=(n, 3) [m].
        partners: the rows at whose points distances start instead, shape=(n,); -1 for a fixed point.
        stations: number of the place from which the instrument saw each row, if that is not known, shape=(n,); 0 for
            the others; None if there are none. Rows are in base axes as the machine described has them.
        homings: number of the earlier homing of the drives at which each row was measured, shape=(n,); 0 for the
            machine's present zeros; None if all are. The zeros of earlier ones are near the present ones, but unknown.
        joints: passive joints with an encoder and the unit of each, "m" or "rad"; their noise follows that of the tool
            in `sigmas`.
        readings: readings of these encoders, shape=(n, joints) [m, rad]; None if there are none.
        datums: spheres, planes, lines, sockets and cameras of unknown placement, with what was measured against them.
            Such a row has only that, as its first columns.
    """

    commands: Array
    positions: Array
    rotations: Array | None
    sigmas: Array
    points: Array
    conditions: dict[str, Array] = field(default_factory=dict)
    lines: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    registration: Registration | None = None
    target_sigma: float = 0.0
    tool_point_sigma: float = 0.0
    times: Array | None = None
    approaches: Array | None = None
    distances: Array | None = None
    origins: Array | None = None
    partners: Indices | None = None
    stations: Indices | None = None
    homings: Indices | None = None
    joints: dict[str, str] = field(default_factory=dict)
    readings: Array | None = None
    datums: tuple[Datum, ...] = ()

    def __post_init__(self) -> None:
        """Check shapes, finite numbers and positive noise."""
        n = len(self.commands)
        if not self.lines:
            object.__setattr__(self, "lines", tuple(range(2, n + 2)))
        readings = np.empty(0) if self.readings is None and self.joints else self.readings
        shapes: list[tuple[str, Array | Indices | None, tuple[int, ...]]] = [
            ("commands", self.commands, (n, self.commands.shape[-1])),
            ("positions", self.positions, (n, 3)),
            ("sigmas", np.where(np.isposinf(self.sigmas), 1.0, self.sigmas), (n, self.tool_columns + len(self.joints))),
            ("points", self.points, (n, 3)),
            ("rotations", self.rotations, (n, 3, 3)),
            *((name, values, (n,)) for name, values in self.conditions.items()),
            ("times", self.times, (n,)),
            ("stations", self.stations, (n,)),
            ("homings", self.homings, (n,)),
            ("readings", readings, (n, len(self.joints))),
            ("approaches", self.approaches, self.commands.shape),
        ]
        for name, array, shape in shapes:
            if array is not None and (array.shape != shape or not np.isfinite(array).all()):
                expected = f"finite numbers, {shape}, one row per measurement"
                raise ShapeError(name, array.shape, expected)
        if self.distances is not None and (
            self.origins is None or self.partners is None or self.origins.shape != (n, 3) or len(self.distances) != n
        ):
            raise InvalidValueError(
                "distances", problem=f"have {len(self.distances)} rows", expected=f"{n}, with origins and partners"
            )
        if not np.all(self.sigmas > 0.0):
            raise InvalidValueError("sigmas", float(self.sigmas.min()), "positive numbers")
        for name in ("target_sigma", "tool_point_sigma"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                expected = "a standard deviation in metres, 0 for exactly known"
                raise InvalidValueError(name, getattr(self, name), expected)

    def __len__(self) -> int:
        return len(self.commands)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.intp] | Sequence[int] | slice) -> Measurements:
        """Return some of the rows."""
        chosen = np.arange(len(self))[rows]
        columns = {name: getattr(self, name) for name in _COLUMNS}
        return replace(
            self,
            **{name: values[chosen] for name, values in columns.items() if values is not None},
            **self._distances_of(chosen),
            conditions={name: values[chosen] for name, values in self.conditions.items()},
            lines=tuple(self.lines[k] for k in chosen),
            datums=tuple(datum[chosen] for datum in self.datums),
        )

    def _distances_of(self, chosen: Indices) -> dict[str, Any]:
        """Return sigmas and distances of some rows, dropping distances to rows that are not among them."""
        sigmas = self.sigmas[chosen]
        if self.distances is None or self.origins is None or self.partners is None:
            return {"sigmas": sigmas}
        places = np.full(len(self) + 1, -2)
        places[chosen] = np.arange(len(chosen))
        places[-1] = -1
        partners, distances = places[self.partners[chosen]], self.distances[chosen]
        lost = partners == -2
        sigmas[lost] = np.inf
        return {
            "sigmas": sigmas,
            "distances": np.where(lost, np.nan, distances),
            "partners": np.where(lost, -1, partners),
        }

    @property
    def seen(self) -> Mask:
        """Mask of the measured coordinates, shape=(n, 3) or (n, 6)."""
        return np.isfinite(self.sigmas)

    @property
    def tool_columns(self) -> int:
        """Number of tool coordinates in a row, 3 or 6, which precede the encoder readings."""
        return 3 if self.rotations is None else 6

    @property
    def shows_poses(self) -> bool:
        """Whether some row measures the tool at one pose, unlike encoders and distances between two poses."""
        alone = self.seen[:, : self.tool_columns].any(axis=1)
        return bool((alone if self.partners is None else alone & (self.partners < 0)).any())

    @property
    def measured(self) -> Measured:
        """What was measured: "pose" or "position"."""
        return "position" if self.rotations is None else "pose"

    @classmethod
    def from_poses(cls, commands: Array, transforms: Array, instrument: Instrument | None = None) -> Measurements:
        """Make measurements of full poses, or of what an instrument sees of them.

        Args:
            commands: readings of the drives' counters, shape=(n, number of commands) [m, rad].
            transforms: measured poses, shape=(n, 4, 4).
            instrument: instrument that determines their noise.

        Raises:
            InvalidValueError: numbers that are not finite, or shapes that do not match.
        """
        seen_by = instrument or Instrument()
        commands = np.array(real_array("commands", commands))
        if commands.ndim != 2:
            raise ShapeError("commands", commands.shape, "(n, number of commands)")
        poses = finite_array("transforms", transforms, (len(commands), 4, 4))
        if seen_by.targets:
            return cls._of_targets(commands, poses, seen_by)
        return cls(
            commands,
            poses[:, :3, 3],
            poses[:, :3, :3] if seen_by.measured == "pose" else None,
            np.tile(seen_by.sigmas, (len(poses), 1)),
            np.zeros((len(poses), 3)),
            registration=AT_THE_BASE if seen_by.own_frame else None,
        )

    @classmethod
    def _of_targets(cls, commands: Array, poses: Array, instrument: Instrument) -> Measurements:
        points = np.array(instrument.targets)
        seen = poses[:, None, :3, 3] + np.einsum("nij,kj->nki", poses[:, :3, :3], points)
        return cls(
            np.repeat(commands, len(points), axis=0),
            seen.reshape(-1, 3),
            None,
            np.full((len(poses) * len(points), 3), instrument.position_sigma),
            np.tile(points, (len(poses), 1)),
            registration=AT_THE_BASE if instrument.own_frame else None,
            target_sigma=instrument.target_sigma,
        )

    @cached_property
    def pose_numbers(self) -> Indices:
        """Pose number of each row, counted from 0 in order of appearance; rows at the same commands are one pose."""
        return _numbered(self.commands)

    @cached_property
    def visits(self) -> Measurements:
        """The first row of each visit, with its commands and conditions."""
        return self[self.first_rows]

    @property
    def first_rows(self) -> Indices:
        """The first row of each visit, shape=(visits,)."""
        return np.unique(self.visit_numbers, return_index=True)[1]

    @cached_property
    def visit_numbers(self) -> Indices:
        """Visit number of each row, counted from 0 in order of appearance; a visit is one stay at a pose.

        Rows at the same commands, temperatures and loads are one visit until an observation is repeated.
        """
        keys = np.column_stack([self.pose_numbers, *self.conditions.values()])
        place = np.column_stack([_numbered(keys), self.observation_numbers]).astype(float)
        again = np.zeros(len(self))
        count: dict[tuple[float, ...], int] = {}
        for row, key in enumerate(map(tuple, place.tolist())):
            again[row] = count[key] = count.get(key, -1) + 1
        return _numbered(np.column_stack([place[:, 0], again]))

    @cached_property
    def target_numbers(self) -> Indices:
        """Target number of each row, counted from 0 in order of appearance; rows with the same `points` share it."""
        return _numbered(self.points)

    @cached_property
    def observation_numbers(self) -> Indices:
        """Number of what each row observes: coordinates of a target, or its distance from some point."""
        keys = [self.target_numbers[:, None], self.seen[:, : self.tool_columns]]
        if self.distances is not None and self.origins is not None and self.partners is not None:
            far, begun = np.isfinite(self.distances), self.partners >= 0
            starts = np.where(begun, self.pose_numbers[self.partners], -1)
            keys += [far[:, None], np.where((far & ~begun)[:, None], self.origins, 0.0), starts[:, None]]
        keys += [datum.rows[:, None] for datum in self.datums]
        return _numbered(np.hstack(keys).astype(float))

    @property
    def on_datums(self) -> Mask:
        """Mask of the rows measured against a datum of unknown placement, shape=(n,)."""
        return np.asarray(np.any([np.zeros(len(self), dtype=bool), *(datum.rows for datum in self.datums)], axis=0))

    def with_datum(self, datum: Datum) -> Measurements:
        """Return the measurements with a datum at another placement, in place of the one of its kind and number."""
        same = (datum.kind.name, datum.number)
        others = (datum if (each.kind.name, each.number) == same else each for each in self.datums)
        return replace(self, datums=tuple(others))

    def in_moved_base(self, twist: Array) -> Measurements:
        """Return the measurements in the axes of a base at [translation; rotation vector] in this one, shape=(6,).

        Raises:
            InvalidValueError: they were measured in base axes, so there is nothing to move.
        """
        return self.registered_as(self._own_frame().moved(twist))

    def registered_as(self, registration: Registration) -> Measurements:
        """Return the measurements in base axes by another registration of the same instrument.

        Raises:
            InvalidValueError: they were measured in base axes.
        """
        own = self._own_frame()
        turn = registration.rotation @ own.rotation.T
        shift = registration.translation - turn @ own.translation
        return replace(self.in_axes(Registration(turn, shift, 0.0)), registration=registration)

    def in_axes(self, registration: Registration) -> Measurements:
        """Return the measurements transformed to other axes by a registration."""
        return replace(
            self,
            positions=registration.positions(self.positions),
            rotations=None if self.rotations is None else registration.rotations(self.rotations),
            origins=None if self.origins is None else registration.positions(self.origins),
        )

    def with_rows_in_axes(self, rows: Mask, registration: Registration) -> Measurements:
        """Return the measurements with some rows, positions and orientations, transformed to other axes."""
        moved = self.in_axes(registration)
        turned = None
        if self.rotations is not None and moved.rotations is not None:
            turned = np.where(rows[:, None, None], moved.rotations, self.rotations)
        return replace(self, positions=np.where(rows[:, None], moved.positions, self.positions), rotations=turned)

    def registered_at(self, poses: Poses, eta: float = TIP_LENGTH) -> Registration:
        """Locate the base from a machine's poses, one for each row; see :func:`register`."""
        rotations = (None, None) if self.rotations is None else (self.rotations, poses.rotations)
        return register(self.positions, self.points_on(poses), *rotations, eta=eta)

    def _own_frame(self) -> Registration:
        if self.registration is None:
            problem = "are in the base's own axes, not in an instrument's: there is no frame to find"
            raise InvalidValueError("measurements", problem=problem)
        return self.registration

    def with_points(self, points: Array) -> Measurements:
        """Return the measurements with other points seen on the tool, shape=(n, 3) [m]."""
        return replace(self, points=points)

    def with_noise(self, generator: np.random.Generator, first: int = 0) -> Measurements:
        """Return positions, distances, rows on datums and encoder readings with noise of their sigmas.

        Columns before `first` stay as they are, and so do orientations.
        """
        noise = generator.standard_normal(self.sigmas.shape) * np.where(np.isfinite(self.sigmas), self.sigmas, 0.0)
        noise[:, :first] = 0.0
        return replace(
            self,
            positions=self.positions + noise[:, :3],
            distances=None if self.distances is None else self.distances + noise[:, 0],
            readings=None if self.readings is None else self.readings + noise[:, self.tool_columns :],
            datums=tuple(replace(each, values=each.values + noise[:, : each.kind.dimension]) for each in self.datums),
        )

    def with_encoders(self, joints: dict[str, str], readings: Array, sigmas: Array) -> Measurements:
        """Return the measurements with readings of passive joints and their noise, shape=(n, joints) each [m, rad]."""
        tool = self.sigmas[:, : self.tool_columns]
        return replace(self, joints=joints, readings=readings, sigmas=np.concatenate([tool, sigmas], axis=1))

    def without_motions(self, poses: Poses, motions: Array) -> Measurements:
        """Return the measurements that would result if the tool had not made given motions from the machine's poses.

        Motions are [translation; rotation vector] of the tool at each row, optionally followed by joints with encoders,
        shape=(n, 6 or 6 + joints) [m, rad].
        """
        turns = rotation_matrix(motions[:, 3:6])
        offsets = self._offsets(poses)
        moved = motions[:, :3] + np.einsum("nij,nj->ni", turns, offsets) - offsets
        readings, joints = self.readings, motions[:, 6:]
        points = self.points_on(poses) if self.datums else offsets
        return replace(
            self,
            datums=tuple(datum.without(points, moved) for datum in self.datums),
            distances=None if self.distances is None else self.distances - self._along_distances(poses, moved),
            readings=readings - joints if readings is not None and joints.size else readings,
            positions=self.positions - moved,
            rotations=None if self.rotations is None else np.swapaxes(turns, 1, 2) @ self.rotations,
        )

    def points_on(self, poses: Poses) -> Array:
        """Return the positions of the points seen on a machine at poses, one for each row, shape=(n, 3) [m]."""
        return np.asarray(poses.positions + self._offsets(poses))

    def _offsets(self, poses: Poses) -> Array:
        """Return the offsets of the points seen from the tool point, world axes, shape=(n, 3) [m]."""
        return np.asarray(np.einsum("nij,nj->ni", poses.rotations, self.points))

    def residuals(self, poses: Poses) -> Array:
        """Return measurements minus the predictions of a machine at poses, shape=(n, 3 or 6, then encoders) [m, rad].

        First the positions of the points seen, then the rotation vector from the machine's orientation to the measured
        one, in world axes; then the encoder readings minus the joints' coordinates.
        """
        positions = self.positions - self.points_on(poses)
        if self.distances is not None:
            size = np.linalg.norm(self._spans(poses), axis=1)
            off = np.column_stack([self.distances - size, np.zeros((len(size), 2))])
            positions = np.where(np.isnan(self.distances)[:, None], positions, off)
        points = self.points_on(poses) if self.datums else positions
        for datum in self.datums:
            off = datum.residuals(points)
            padded = np.pad(off, ((0, 0), (0, 3 - off.shape[1])))
            positions = np.where(datum.rows[:, None], padded, positions)
        parts = [positions]
        if self.rotations is not None:
            seen = np.tile(np.eye(4), (len(poses), 1, 1))
            seen[:, :3, :3] = self.rotations
            parts.append(pose_difference(poses.transforms, seen)[:, 3:])
        if self.readings is not None:
            parts.append(self.readings - joint_coordinates(poses.robot, poses.q, tuple(self.joints)))
        return np.concatenate(parts, axis=1)

    def tip_misfits(self, poses: Poses, eta: float = TIP_LENGTH) -> Array:
        """Return the tip-weighted size of the residuals of the tool, shape=(n,) [m]; see :meth:`residuals`."""
        tool = self.tool_columns
        # the first columns are distances, too
        weights = np.concatenate([np.ones(3), tip_weights(eta, poses.robot.tool_motions)[3:]])
        residuals = self.residuals(poses)[:, :tool] * weights[:tool]
        return np.asarray(np.linalg.norm(np.where(self.seen[:, :tool], residuals, 0.0), axis=1))

    def derivatives(self, poses: Poses, tool_motions: Array) -> Array:
        """Return the derivatives of the negative residuals by given tool motions, shape=(n, rows, k).

        The motions of the poses, optionally followed by joints with encoders, have shape=(n, 6 or 6 + joints, k).
        """
        offsets = self._offsets(poses)
        linear, angular, tool = tool_motions[:, :3], tool_motions[:, 3:6], self.tool_columns
        found = np.zeros((len(self), tool + len(self.joints), tool_motions.shape[2]))
        points = found[:, :3]
        x, y, z = offsets.T
        turning = np.zeros((len(self), 3, 3))  # the point's motion by turning: w x r
        turning[:, 0, 1], turning[:, 1, 2], turning[:, 2, 0] = z, x, y
        np.matmul(turning - np.swapaxes(turning, 1, 2), angular, out=points)
        points += linear
        if self.distances is not None:
            measured = ~np.isnan(self.distances)
            along = self._along_distances(poses, points)[measured]
            points[measured] = 0.0
            points[measured, 0] = along
        places = self.points_on(poses) if self.datums else offsets
        for datum in self.datums:
            rows = (datum.directions(places) @ points)[datum.rows]
            points[datum.rows] = 0.0
            points[datum.rows, : rows.shape[1]] = rows
        if self.rotations is not None:
            rates = rotation_vector_rates(self.rotations @ np.swapaxes(poses.rotations, 1, 2))
            np.matmul(rates, angular, out=found[:, 3:6])
        if tool_motions.shape[1] > 6:
            found[:, tool:] = tool_motions[:, 6:]
        return found

    def _spans(self, poses: Poses) -> Array:
        """Return the vectors along distances, from start to the points seen, on a machine, shape=(n, 3) [m]."""
        assert self.origins is not None
        points = self.points_on(poses)
        return np.asarray(points - np.where(self._fixed, self.origins, points[self.partners]))

    def _along_distances(self, poses: Poses, motions: Array) -> Array:
        """Return the change of distances by motions of the points seen, shape=(n, ...) of (n, 3, ...)."""
        spans = self._spans(poses)
        directions = spans / np.maximum(np.linalg.norm(spans, axis=1, keepdims=True), SAME)
        fixed = self._fixed.reshape(-1, *[1] * (motions.ndim - 1))
        relative = motions - np.where(fixed, 0.0, motions[self.partners])
        return np.asarray(np.einsum("ni,ni...->n...", directions, relative))

    @property
    def _fixed(self) -> Mask:
        assert self.partners is not None
        return np.asarray(self.partners < 0)[:, None]


def joint_coordinates(robot: Robot, q: Array, joints: Sequence[str]) -> Array:
    """Return the coordinates of single-DoF joints from those of a model, shape=(n, nq) to (n, joints) [m, rad]."""
    found = np.zeros((len(q), len(joints)))
    for k, name in enumerate(joints):
        joint = robot.single_joint(name)
        at = q[:, joint.q_index]
        found[:, k] = np.arctan2(q[:, joint.q_index + 1], at) if joint.is_continuous else at
    return found


def with_joints(motions: Array, joints: int) -> Array:
    """Return tool motions, shape=(n, 6, k), with rows for joints; missing rows are zero."""
    if motions.shape[1] == 6 + joints:
        return motions
    still = np.zeros((len(motions), 6 + joints - motions.shape[1], motions.shape[2]))
    return np.concatenate([motions, still], axis=1)


def _numbered(rows: Array) -> Indices:
    """Number distinct rows from 0 in order of appearance, shape=(n,)."""
    _, first, numbers = np.unique(np.round(rows / SAME), axis=0, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[numbers.reshape(-1)])
