"""Options of commands about joints driven through loops: which joints and drives, their limits, and the box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.map_options import CoordinateRange, declared_ranges, robot_grid
from pm3dof_pin.cli.options import Payload, finite_number, numbers_by_name, payloads_of

if TYPE_CHECKING:
    from pm3dof_pin.capability.transmission import Transmission
    from pm3dof_pin.kinematics.robot import Poses, Robot
    from pm3dof_pin.typing import Vector

_POINTS = 21
_LIMITS = "N|JOINT=N,.."


@dataclass(frozen=True, kw_only=True)
class TransmissionOptions:
    """Joints, drives, limits and the box of a transmission."""

    joints: Annotated[
        str | None, typer.Option(metavar="A,B", help="Joints of the serial model; the robot's coordinates by default.")
    ] = None
    drives: Annotated[str | None, typer.Option(metavar="A,B", help="Driven joints; the description's by default.")] = (
        None
    )
    subtree: Annotated[
        str | None, typer.Option(metavar="LINK", help="Only what this link carries; all other joints are held at home.")
    ] = None
    over: Annotated[
        list[CoordinateRange] | None,
        typer.Option(
            "--over",
            metavar="NAME FIRST LAST COUNT",
            parser=CoordinateRange.parse,
            help="Values of a joint [deg, m]; may be repeated. By default each joint's range.",
        ),
    ] = None
    effort: Annotated[
        str | None,
        typer.Option(metavar=_LIMITS, help="Greatest effort of the drives [N m, N]; the description's by default."),
    ] = None
    speed: Annotated[
        str | None,
        typer.Option(metavar=_LIMITS, help="Greatest speed of the drives [rad/s, m/s]; the description's by default."),
    ] = None
    armature: Annotated[
        str | None,
        typer.Option(metavar=_LIMITS, help="Inertia of the rotors at the driven joints [kg m^2, kg]."),
    ] = None
    gains: Annotated[
        str | None, typer.Option(metavar="KP,KD", help="Gains of each drive; the description's by default.")
    ] = None
    payload: Payload = 0.0

    def part(self, robot: Robot) -> Robot:
        """Return the part of a robot that is asked about, with the joints as its coordinates."""
        from pm3dof_pin.capability.transmission import held_outside, joint_driven

        if self.subtree is not None:
            robot = held_outside(robot, self.subtree)
        return joint_driven(robot, _names(self.joints), _names(self.drives))

    def at(self, poses: Poses) -> Transmission:
        """Compute the transmission at poses within the given limits; those that are out of reach are NaN."""
        from pm3dof_pin.capability.transmission import transmission

        limits: Any = {
            "effort": numbers_by_name("--effort", self.effort),
            "speed": numbers_by_name("--speed", self.speed),
            "armature": numbers_by_name("--armature", self.armature),
            "payloads": payloads_of(poses.robot, self.payload),
        }
        return transmission(poses.robot, poses, on_failure="nan" if poses.shape else "raise", **limits)

    def box(self, robot: Robot) -> Transmission:
        """Compute the transmission over the box."""
        ranges = self.over or declared_ranges(robot, robot.coordinates, [_POINTS] * len(robot.coordinates))
        return self.at(robot.solve(robot_grid(robot, ranges), on_failure="nan"))

    def gains_of(self, robot: Robot) -> dict[str, Vector | float | None]:
        """Return the gains of the drives as "kp" and "kd": those given, or those that all drives are described with."""
        numbers: Sequence[float] = [finite_number(entry) for entry in _names(self.gains)]
        if len(numbers) not in (0, 2):
            raise typer.BadParameter(f"--gains {self.gains}: expected KP,KD")
        if not numbers:
            from pm3dof_pin.capability.transmission import described_gains

            return dict(described_gains(robot))
        return dict(zip(("kp", "kd"), numbers, strict=True))


def _names(text: str | None) -> list[str]:
    return [name.strip() for name in (text or "").split(",") if name.strip()]
