"""A delta printer as its firmware describes it, linear or rotary, and as a robot.

The nozzle, at x, hangs on three arms of lengths L from points c, moved by the drives: |x - c_k| = L_k. On a linear
delta a carriage slides along a tower at the delta radius R, on a rotary one an upper arm of length l turns about a
shoulder at radius R and height H:

    c_k = Rz(angle_k) (R, 0, carriage),      c_k = Rz(angle_k) (R + l cos q, 0, H + l sin q).

Firmware gives the drive's coordinate at its end stop by the height E_k at which the nozzle would then be over the
centre of the bed. Parallel rods, the effector's size and the nozzle's offset are part of R and L. The robot has the
same equations with a rod and one ball joint for each arm; its commands are the drives' travels from their end stops,
which no parameter changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pm3dof_pin.description.error_file import TiedEntry, error_file_text
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.typing import Array, Vector

AXES = "abc"
"""Names of the drives in firmware."""

_NUMBERED = dict(enumerate(AXES, start=1))
_GROUP = "firmware"
_REACH = 3.0  # [m], wider than any printer
_DISTANCE, _ZERO, _ZERO_ANGLE, _ANGLE, _ARM = 3e-3, 5e-3, 5e-2, 2e-2, 1e-3  # tolerances [m, rad]


@dataclass(frozen=True)
class DeltaPrinter:
    """The numbers of a delta printer [m, rad]."""

    radius: float  #: R
    angles: tuple[float, float, float]  #: of the towers or shoulders about the vertical, from x
    arms: tuple[float, float, float]  #: L
    end_stops: tuple[float, float, float]  #: E
    upper_arms: tuple[float, float, float] | None = None  #: l; None for a linear delta
    shoulder_height: float = 0.0  #: H

    def __post_init__(self) -> None:
        """Check sizes.

        Raises:
            InvalidValueError: a length is not positive, or the nozzle cannot reach the centre of the bed.
        """
        lengths = {"radius": self.radius, **{f"arm_{AXES[k]}": arm for k, arm in enumerate(self.arms)}}
        for name, value in lengths.items():
            if not 0.0 < value < _REACH:
                raise InvalidValueError(f"delta printer: {name}", f"{1e3 * value:g} mm", "a positive length")
        try:
            self.drives(np.zeros((1, 3)))
        except UnreachablePoseError as error:
            expected = "arms that reach the centre of the bed: radius or arm lengths are wrong"
            raise InvalidValueError("delta printer", problem="does not close", expected=expected) from error

    @property
    def is_rotary(self) -> bool:
        """Whether the drives turn."""
        return self.upper_arms is not None

    @property
    def unit(self) -> str:
        """Unit of the drives, "m" or "rad"."""
        return "rad" if self.is_rotary else "m"

    def drives(self, points: Array) -> Array:
        """Return the drives' coordinates with the nozzle at points, shape=(n, 3) [m, rad].

        Raises:
            UnreachablePoseError: an arm does not reach a point.
        """
        towers = np.stack([self._outward(k) for k in range(3)])
        along = points @ towers.T  # of each tower
        across = np.sum(points[:, :2] ** 2, axis=1)[:, None] - along**2
        heights, arms = points[:, 2:], np.array(self.arms)
        if self.upper_arms is None:
            squares = arms**2 - (self.radius - along) ** 2 - across
            _require(squares)
            return np.asarray(heights + np.sqrt(squares))
        upper, out, up = np.array(self.upper_arms), self.radius - along, self.shoulder_height - heights
        # out cos q + up sin q = need
        need = (arms**2 - across - out**2 - up**2 - upper**2) / (2.0 * upper)
        size = np.hypot(out, up)
        _require(size**2 - need**2)
        middle, half = np.arctan2(up, out), np.arccos(need / size)
        ends = np.stack([middle - half, middle + half])
        chosen = np.take_along_axis(ends, np.argmax(np.cos(ends), axis=0)[None], axis=0)[0]  # elbows point outward
        return np.asarray((chosen + math.pi) % (2.0 * math.pi) - math.pi)

    @property
    def at_end_stops(self) -> Vector:
        """The drives' coordinates at their end stops, shape=(3,) [m, rad]."""
        return np.array([self.drives(np.array([[0.0, 0.0, stop]]))[0, k] for k, stop in enumerate(self.end_stops)])

    def displaced(self, named: dict[str, float]) -> DeltaPrinter:
        """Return the printer with identified values of the parameters of :meth:`parameters`, for its firmware."""
        radius = self.radius + named.get("radius", 0.0)
        angles = [angle + named.get(f"angle_{AXES[k]}", 0.0) for k, angle in enumerate(self.angles)]
        longer = named.get("arms", 0.0)
        arms = [arm + longer + named.get(f"arm_{AXES[k]}", 0.0) for k, arm in enumerate(self.arms)]
        height = self.shoulder_height + named.get("shoulder_height", 0.0)
        stops = []
        for k, zero in enumerate((self.at_end_stops + [named.get(f"end_stop_{axis}", 0.0) for axis in AXES]).tolist()):
            out, up = (radius, zero) if self.upper_arms is None else _elbow(radius, height, self.upper_arms[k], zero)
            stops.append(float(up - math.sqrt(arms[k] ** 2 - out**2)))
        return replace(
            self,
            radius=radius,
            angles=(angles[0], angles[1], angles[2]),
            arms=(arms[0], arms[1], arms[2]),
            end_stops=(stops[0], stops[1], stops[2]),
            shoulder_height=height,
        )

    def parameters(self, count: int) -> tuple[TiedEntry, ...]:
        """Return a set of error parameters as firmware has them, ties of the robot's displacements.

        Linear deltas have 6 (radius, end stops, two towers' angles), 7 (and the length of all arms) or 9 (of each);
        rotary ones 4 (shoulder height and end stops) or 7 (and radius and two angles).
        """
        zero = _ZERO_ANGLE if self.is_rotary else _ZERO
        stops = {axis: f"drive{k}_joint.r_along" if self.is_rotary else f"rail{k}.tz" for k, axis in _NUMBERED.items()}
        ties = [TiedEntry(f"end_stop_{axis}", {part: 1.0}, _GROUP, zero, self.unit) for axis, part in stops.items()]
        if self.is_rotary:
            ties.append(_equal("shoulder_height", "rail{}.tz", _DISTANCE))
        if count > 4:
            ties.append(_equal("radius", "rail{}.tx", _DISTANCE))
            ties += [TiedEntry(f"angle_{AXES[k]}", {f"tower{k + 1}.rz": 1.0}, _GROUP, _ANGLE, "rad") for k in (0, 1)]
        if count == 7 and not self.is_rotary:
            ties.append(_equal("arms", "arm{}_tip.tz", _ARM))
        if count == 9:
            ties += [
                TiedEntry(f"arm_{axis}", {f"arm{k}_tip.tz": 1.0}, _GROUP, _ARM, "m") for k, axis in _NUMBERED.items()
            ]
        return tuple(ties)

    def numbers(self, names: Sequence[str]) -> Vector:
        """Return the firmware's numbers that parameters of :meth:`parameters` change, shape=(names,) [m, rad].

        Of all arms it is the mean.
        """
        known = {"radius": self.radius, "arms": float(np.mean(self.arms)), "shoulder_height": self.shoulder_height}
        for word, values in (("angle", self.angles), ("arm", self.arms), ("end_stop", self.end_stops)):
            known |= {f"{word}_{axis}": value for axis, value in zip(AXES, values, strict=True)}
        return np.array([known[name] for name in names])

    @property
    def counts(self) -> tuple[int, ...]:
        """The sizes of its sets of :meth:`parameters`, from the smallest."""
        return (4, 7) if self.is_rotary else (6, 7, 9)

    def files(self, count: int) -> dict[str, str]:
        """Return the robot's URDF, closures and error file with some :meth:`parameters`, by the end of their names."""
        comment = f"The {count} parameters of the printer's firmware. Tolerances are standard deviations."
        errors = error_file_text((), comment=comment, command_zeros={}, ties=self.parameters(count))
        return {".urdf": self._urdf(), ".closures.yaml": self._closures(), ".errors.yaml": errors}

    def as_data(self) -> dict[str, Any]:
        """Return the numbers as plain data; keys end in their unit."""
        data: dict[str, Any] = {
            "radius_m": self.radius,
            "angles_rad": list(self.angles),
            "arms_m": list(self.arms),
            "end_stops_m": list(self.end_stops),
        }
        if self.upper_arms is not None:
            data |= {"upper_arms_m": list(self.upper_arms), "shoulder_height_m": self.shoulder_height}
        return data

    def _outward(self, k: int) -> Vector:
        return np.array([math.cos(self.angles[k]), math.sin(self.angles[k]), 0.0])

    def _urdf(self) -> str:
        """Return the robot with the nozzle at the centre of the bed at home."""
        home, parts = self.drives(np.zeros((1, 3)))[0], ['<robot name="delta_printer">', '  <link name="base"/>']

        def joint(name: str, kind: str, parent: str, child: str, xyz: Vector, rpy: Vector, axis: str = "") -> None:
            limit = _REACH if kind == "prismatic" else math.pi
            inside = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'
            if axis:
                inside += f'<axis xyz="{axis}"/><limit lower="{-limit}" upper="{limit}" effort="1" velocity="1"/>'
            parts.extend(
                [
                    f'  <link name="{child}"/>',
                    f'  <joint name="{name}" type="{kind}">{inside}</joint>',
                ]
            )

        zero = np.zeros(3)
        for k, number in enumerate((1, 2, 3)):
            joint(f"tower{number}_fixed", "fixed", "base", f"tower{number}", zero, _turn(2, self.angles[k]))
            drive, link, rail = f"drive{number}_joint", f"drive{number}", f"rail{number}"
            end, start, turned = (self.radius, home[k]), zero, 0.0  # outward and up
            if self.upper_arms is None:
                joint(f"{rail}_fixed", "fixed", f"tower{number}", rail, np.array([self.radius, 0.0, home[k]]), zero)
                joint(drive, "prismatic", rail, link, zero, zero, "0 0 1")
            else:
                at, turned = np.array([self.radius, 0.0, self.shoulder_height]), -home[k]
                joint(f"{rail}_fixed", "fixed", f"tower{number}", rail, at, zero)
                joint(drive, "revolute", rail, link, zero, _turn(1, turned), "0 -1 0")
                end = _elbow(self.radius, self.shoulder_height, self.upper_arms[k], home[k])
                start = np.array([self.upper_arms[k], 0.0, 0.0])
            # from the drive's point to the nozzle, in the plane of the tower; the rod is along z
            tilt, cross, arm = math.atan2(-end[0], -end[1]) - turned, f"arm{number}_cross", f"arm{number}"
            joint(f"arm{number}_first_joint", "revolute", link, cross, start, _turn(1, tilt), "1 0 0")
            joint(f"arm{number}_second_joint", "revolute", cross, arm, zero, zero, "0 1 0")
            tip = np.array([0.0, 0.0, self.arms[k]])
            joint(f"arm{number}_tip_fixed", "fixed", arm, f"arm{number}_tip", tip, zero)
        for name, parent, axis in (("x", "base", "1 0 0"), ("y", "x", "0 1 0"), ("z", "y", "0 0 1")):
            child = "nozzle" if name == "z" else name
            joint(f"{name}_joint", "prismatic", parent, child, zero, zero, axis)
        for number in (1, 2, 3):
            joint(f"end{number}_fixed", "fixed", "nozzle", f"end{number}", zero, zero)
        return "\n".join([*parts, "</robot>", ""])

    def _closures(self) -> str:
        offsets = self.drives(np.zeros((1, 3)))[0] - self.at_end_stops
        commands = [
            f"  - {{name: u{k}, joint: drive{k}_joint, unit: {self.unit}, offset: {offset!r}}}"
            for k, offset in enumerate(offsets.tolist(), start=1)
        ]
        reach = 0.9 * self.radius if self.upper_arms is None else 0.5 * min(self.arms)
        height = max(min(self.end_stops), 0.01)
        return "\n".join(
            [
                "closed_loop: [[arm1_tip, end1], [arm2_tip, end2], [arm3_tip, end3]]",
                "type: ['3d', '3d', '3d']",
                "name_mot: [drive1_joint, drive2_joint, drive3_joint]",
                "joint_name: []",
                "joint_type: []",
                "tool_frame: nozzle",
                "motion_coordinates: [x_joint, y_joint, z_joint]",
                "commands:",
                *commands,
                "coordinates:",
                *(f"  - {{name: {c}, joint: {c}_joint, unit: m, range: [{-reach!r}, {reach!r}]}}" for c in "xy"),
                f"  - {{name: z, joint: z_joint, unit: m, range: [0.0, {height!r}]}}",
                "",
            ]
        )


def _elbow(radius: float, height: float, arm: float, angle: float) -> tuple[float, float]:
    return radius + arm * math.cos(angle), height + arm * math.sin(angle)


def _equal(name: str, part: str, tolerance: float) -> TiedEntry:
    return TiedEntry(name, {part.format(k): 1.0 for k in _NUMBERED}, _GROUP, tolerance, "m")


def _require(squares: Array) -> None:
    if not (squares > 0.0).all():
        raise UnreachablePoseError("an arm of the printer does not reach a point")


def _turn(axis: int, angle: float) -> Vector:
    return np.asarray(angle * np.eye(3)[axis])


def _text(numbers: Vector) -> str:
    return " ".join(repr(float(number)) for number in numbers)
