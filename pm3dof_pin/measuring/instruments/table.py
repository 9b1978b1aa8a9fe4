"""The table of instruments: a new one is a file beside this one, and a line here.

Planning, simulation, the reader and writer of files, checks and fits take from it whatever they need to know of one.
"""

from __future__ import annotations

from dataclasses import replace

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.datum import DatumKind
from pm3dof_pin.measuring.instrument import Instrument, Point
from pm3dof_pin.measuring.instruments.camera import CAMERA
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.measuring.instruments.level import LEVEL
from pm3dof_pin.measuring.instruments.line import LINE
from pm3dof_pin.measuring.instruments.lock import LOCK
from pm3dof_pin.measuring.instruments.plane import GAUGE, PROBE
from pm3dof_pin.measuring.instruments.socket import SOCKET
from pm3dof_pin.measuring.instruments.sphere import BALLBAR, SPHERE, WIRES
from pm3dof_pin.measuring.instruments.tracker import TRACKER

INSTRUMENTS: dict[str, InstrumentKind] = {
    "tracker": TRACKER,
    "ballbar": BALLBAR,
    "wires": WIRES,
    "probe": PROBE,
    "gauge": GAUGE,
    "line": LINE,
    "socket": SOCKET,
    "camera": CAMERA,
    "level": LEVEL,
    "lock": LOCK,
}
"""The instruments by name."""


def datum_kinds() -> dict[str, DatumKind]:
    """Return what rows can be measured against, by the column that holds its number."""
    kinds = (instrument.datum for instrument in INSTRUMENTS.values())
    return {kind.name: kind for kind in kinds if kind is not None}


def placed_instrument(
    name: str,
    poses: Poses,
    *,
    sigma: float | None = None,
    point: Point | None = None,
    centres: tuple[Point, ...] = (),
    length: float | None = None,
    known_centres: bool = False,
    joints: tuple[str, ...] = (),
    target_sigma: float = 0.0,
) -> Instrument:
    """Return an instrument of a name, placed where it sees or touches given poses.

    Args:
        name: of the table.
        poses: where the machine can go. If they all touch something already, as poses planned for the instrument do,
            that is where it is.
        sigma: noise of a coordinate [m], of a level [rad]; by default the usual one.
        point: the ball, stylus or target, in tool axes [m]; the tool point by default, for a camera four targets.
        centres: points from which distances are measured, base axes [m]: one for a ballbar, any number of wires; for
            others one, where the plane, line or seat is, or the camera stands. By default beside the poses.
        length: length of a ballbar [m].
        known_centres: whether the centres were measured beforehand.
        joints: passive joints that are locked.
        target_sigma: prior standard deviation of the target's coordinates [m]; 0 if known exactly.

    Raises:
        InvalidValueError: an unknown name, too many centres, a length or noise that is not positive, known centres
            that are not given or not of distances, or a lock without joints.
    """
    if name not in INSTRUMENTS:
        raise InvalidValueError("instrument", name, f"one of {', '.join(INSTRUMENTS)}")
    kind = INSTRUMENTS[name]
    if known_centres and not (centres and kind.datum is SPHERE):
        raise InvalidValueError("known centres", problem="are not given", expected="those of wires or a ballbar")
    found = kind.placed(Setting(poses, kind.sigma if sigma is None else sigma, point, centres, length, joints))
    return replace(found, known_centres=known_centres, target_sigma=target_sigma)
