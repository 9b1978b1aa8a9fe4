"""Instruments by name: what each sees of a pose, what the pose must touch, and where it stands.

==========  ======================================================  ===============================================
name        rows of a pose                                          beside the machine, unknown
==========  ======================================================  ===============================================
tracker     position and orientation, by targets                    the frame, with `own_frame`
ballbar     the distance of a ball from a socket, at one length     the socket's centre
wires       distances from several points, of any length            each of these points
probe       a touch of a plane                                      the plane
gauge       a height above a plane                                  the plane
line        a touch of a straight edge or taut wire                 the line
socket      a ball held in a seat, the tool turning about it        the seat
camera      image points of targets on the tool                     the camera's placement; its intrinsics are known
level       two tilts                                               nothing: the base is level
==========  ======================================================  ===============================================
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from pm3dof_pin.errors.command_correction import command_jacobians
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.datum import DATUM_KINDS, Datum
from pm3dof_pin.measuring.instrument import TARGET_COUNT, TARGET_RADIUS, Instrument
from pm3dof_pin.measuring.measurement_file import encoder_column
from pm3dof_pin.measuring.measurements import Measurements, joint_coordinates
from pm3dof_pin.typing import Array

InstrumentName = Literal["tracker", "ballbar", "wires", "probe", "gauge", "line", "socket", "camera", "level"]

SIGMAS: dict[InstrumentName, float] = {
    "ballbar": 1e-6,
    "wires": 50e-6,
    "probe": 5e-6,
    "gauge": 2e-6,
    "line": 5e-6,
    "socket": 2e-6,
    "camera": 20e-6,
    "level": 10e-6,
}
"""Usual noise of instruments other than trackers [m]; of levels [rad]."""

BALLBAR_LENGTH = 0.15
"""Length of a ballbar [m]."""

_ROUNDS = 12
_TOUCHING = 1e-8  # [m]
_TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]) / np.sqrt(3.0)
_CAMERA_DIRECTION = np.array([1.0, 0.5, 2.0])
_AWAY = 3.0  # times the greater of the extent of the points seen and their distance from the tool point


def placed_instrument(
    name: InstrumentName,
    poses: Poses,
    *,
    sigma: float | None = None,
    point: tuple[float, float, float] | None = None,
    centres: tuple[tuple[float, float, float], ...] = (),
    length: float = BALLBAR_LENGTH,
) -> Instrument:
    """Return an instrument of a name, placed where it sees or touches given poses.

    Args:
        name: of the table above; a tracker sees full poses.
        poses: where the machine can go.
        sigma: noise of a coordinate [m]; see :data:`SIGMAS`.
        point: the ball, stylus or target, in tool axes [m]; the tool point by default, for a camera four targets.
        centres: points from which distances are measured, base axes [m]: one for a ballbar, any number of wires; for
            others one, where the plane, line or seat is, or the camera stands. By default beside the poses.
        length: length of a ballbar [m].

    Raises:
        InvalidValueError: an unknown name, too many centres, or a length or noise that is not positive.
    """
    if name not in get_args(InstrumentName):
        raise InvalidValueError("instrument", name, f"one of {', '.join(get_args(InstrumentName))}")
    if name == "tracker":
        return Instrument()
    noise = SIGMAS[name] if sigma is None else sigma
    if name == "level":
        return Instrument("pose", position_sigma=noise, angle_sigma=noise, tilts_only=True)
    if not (np.isfinite(length) and length > 0.0):
        raise InvalidValueError("length", length, "a positive number of metres")
    if len(centres) > 1 and name != "wires":
        raise InvalidValueError("centres", len(centres), f"one for a {name}")
    targets: tuple[tuple[float, float, float], ...] = (point or (0.0, 0.0, 0.0),)
    if name == "camera" and point is None:
        around = 2.0 * np.pi * np.arange(TARGET_COUNT) / TARGET_COUNT
        circle = TARGET_RADIUS * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
        targets = tuple((float(x), float(y), float(z)) for x, y, z in circle)
    own = Instrument("position", position_sigma=noise, targets=targets)
    points = (poses.positions[:, None] + np.einsum("nij,kj->nki", poses.rotations, np.array(targets))).reshape(-1, 3)
    middle = np.median(points, axis=0)
    extent = max(float(np.linalg.norm(points - middle, axis=1).max()), poses.robot.characteristic_length)
    if name in ("ballbar", "wires"):
        # a ball on a bar of one length must be able to go round its socket: beside the longest way
        longest = np.linalg.svd(points - middle, full_matrices=False)[2][:1]
        away = extent * _TETRAHEDRON if name == "wires" else -length * longest
        given = centres or _as_tuples(middle + away)
        return replace(own, centres=given, length=length if name == "ballbar" else None)
    place = np.array(centres[0]) if centres else middle
    axes = np.eye(3)
    if name == "line":
        axes = np.eye(3)[[1, 2, 0]]
    if name == "camera":
        if not centres:
            place = middle + _AWAY * extent * _CAMERA_DIRECTION / np.linalg.norm(_CAMERA_DIRECTION)
        ahead = (middle - place) / np.linalg.norm(middle - place)
        across = np.cross([0.0, 0.0, 1.0] if abs(ahead[2]) < 0.99 else [0.0, 1.0, 0.0], ahead)
        across /= np.linalg.norm(across)
        axes = np.array([across, np.cross(ahead, across), ahead])
    kind = {"probe": "plane", "gauge": "plane"}.get(name, name)
    return replace(
        own,
        datum=kind,
        datum_place=_as_tuples([place])[0],
        datum_axes=_as_tuples(axes),
        touches=name not in ("gauge", "camera"),
    )


def planned_measurements(poses: Poses, instrument: Instrument) -> Measurements:
    """Return what an instrument would see of poses, as many rows for each, in their order.

    Raises:
        InvalidValueError: an encoder of a joint without one, or too few poses for a datum.
    """
    if not instrument.centres and not instrument.datum:
        return _with_encoders(Measurements.from_poses(poses.commands, poses.transforms, instrument), poses, instrument)
    targets = np.array(instrument.targets)
    each = len(targets) * max(1, len(instrument.centres))
    rows = np.repeat(np.arange(len(poses)), each)
    offsets = np.tile(np.repeat(targets, max(1, len(instrument.centres)), axis=0), (len(poses), 1))
    sigmas = np.full((len(rows), 3), np.inf)
    at = poses[rows]
    points = at.positions + np.einsum("nij,nj->ni", at.rotations, offsets)
    found = Measurements(at.commands, at.positions, None, np.ones((len(rows), 3)), offsets)
    if instrument.centres:
        sigmas[:, 0] = instrument.position_sigma
        numbers = np.tile(np.arange(len(instrument.centres)), len(poses) * len(targets))
        origins = np.array(instrument.centres)[numbers]
        distances = np.linalg.norm(points - origins, axis=1)
        alone = np.full(len(rows), -1)
        spheres = None if instrument.known_centres else numbers + 1
        found = replace(found, distances=distances, origins=origins, partners=alone, spheres=spheres)
    else:
        entry = DATUM_KINDS[instrument.datum]
        datum = _datum(instrument, len(rows))
        values = -datum.residuals(points)
        if instrument.datum == "camera":
            depths = ((points - datum.origin) @ datum.axes.T)[:, 2]
            values, datum = values * depths[:, None], replace(datum, scales=depths)
        sigmas[:, : entry.dimension] = instrument.position_sigma
        found = replace(found, datums=(replace(datum, values=values),))
    return _with_encoders(replace(found, sigmas=sigmas), poses, instrument)


def touching_poses(poses: Poses, instrument: Instrument) -> Poses:
    """Move poses until the instrument touches, by Newton's method on the commands, and return those that do.

    Raises:
        UnreachablePoseError: none can.
    """
    if not instrument.touches and instrument.length is None:
        return poses
    robot, offset, at = poses.robot, np.array(instrument.targets[0]), poses
    for _ in range(_ROUNDS):
        arms = at.rotations @ offset
        off, directions = _gaps(instrument, at.positions + arms)
        if np.abs(off).max(initial=0.0) < _TOUCHING:
            break
        motions = command_jacobians(at)
        linear = motions[:, :3] + np.cross(motions[:, 3:], arms[:, :, None], axisa=1, axisb=1, axisc=1)
        steps = np.einsum("nij,nj->ni", np.linalg.pinv(directions @ linear, rcond=1e-6), off)
        at = robot.forward(at.commands + steps, guess=at.q, on_failure="nan")
        at = at[at.solved]
        if not len(at):
            break
    if len(at):
        off, _ = _gaps(instrument, at.positions + at.rotations @ offset)
        at = at[(np.abs(off).max(axis=1) < _TOUCHING) & at.within_limits]
    if not len(at):
        where = instrument.centres[0] if instrument.centres else instrument.datum_place
        what = instrument.datum or f"sphere of {instrument.length} m"
        at_point = " ".join(f"{value:.4g}" for value in where)
        raise UnreachablePoseError(f"{robot.name}: the {what} at {at_point} is out of reach of the point that touches")
    return at


def _gaps(instrument: Instrument, points: Array) -> tuple[Array, Array]:
    """Return what is missing until points touch, shape=(n, d) [m], and its directions, shape=(n, d, 3)."""
    if instrument.length is not None:
        spans = points - np.array(instrument.centres[0])
        sizes = np.linalg.norm(spans, axis=1)
        return (instrument.length - sizes)[:, None], (spans / sizes[:, None])[:, None, :]
    datum = _datum(instrument, len(points))
    return datum.residuals(points), datum.directions(points)


def _datum(instrument: Instrument, rows: int) -> Datum:
    nothing = np.zeros((rows, DATUM_KINDS[instrument.datum].dimension))
    axes, origin = np.array(instrument.datum_axes), np.array(instrument.datum_place)
    return Datum(instrument.datum, 1, axes, origin, nothing, np.ones(rows))


def _with_encoders(measurements: Measurements, poses: Poses, instrument: Instrument) -> Measurements:
    """Add the readings of the instrument's encoders to the first row of each pose."""
    if not instrument.encoders:
        return measurements
    for joint in instrument.encoders:
        encoder_column(poses.robot, joint)
    joints: dict[str, str] = {joint: poses.robot.single_joint(joint).unit for joint in instrument.encoders}
    rows = len(measurements) // len(poses)
    noise = [instrument.position_sigma if unit == "m" else instrument.angle_sigma for unit in joints.values()]
    sigmas = np.full((len(measurements), len(joints)), np.inf)
    sigmas[::rows] = noise
    return measurements.with_encoders(joints, np.repeat(joint_coordinates(poses, tuple(joints)), rows, axis=0), sigmas)


def _as_tuples(rows: Array | list[Array]) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)
