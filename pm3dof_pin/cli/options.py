"""Arguments and options that several subcommands share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.mechanism.configuration import Configuration

THE_TRIPOD = "pm3dof"


def finite_number(text: str) -> float:
    """Read a number; negative ones come as arguments, and so do misspelt options, which have to be told from them."""
    try:
        number = float(text)
    except ValueError:
        kind = "neither a number nor an option" if text.startswith("-") else "not a number"
        raise typer.BadParameter(f"{text} is {kind}") from None
    if not math.isfinite(number):
        raise typer.BadParameter(f"{text} is not a finite number")
    return number


def tilt_angle(text: str) -> float:
    """Read the angle to which tilts run on either side."""
    angle = finite_number(text)
    if not 0.0 < angle <= 180.0:
        raise typer.BadParameter(f"{text} is not an angle above 0 and up to 180 degrees")
    return angle


def _finite(number: float | None) -> float | None:
    if number is not None and not math.isfinite(number):
        raise typer.BadParameter(f"{number} is not a finite number")
    return number


ThetaX = Annotated[float, typer.Argument(metavar="TX", help="Rotation theta_x about x [deg].", parser=finite_number)]
ThetaY = Annotated[float, typer.Argument(metavar="TY", help="Rotation theta_y about y [deg].", parser=finite_number)]
Height = Annotated[float, typer.Argument(metavar="Z", help="Height z_e of the tool point [m].", parser=finite_number)]
OptionalThetaX = Annotated[
    float | None, typer.Argument(metavar="TX", help="Rotation theta_x about x [deg].", parser=finite_number)
]
OptionalThetaY = Annotated[
    float | None, typer.Argument(metavar="TY", help="Rotation theta_y about y [deg].", parser=finite_number)
]
OptionalHeight = Annotated[
    float | None, typer.Argument(metavar="Z", help="Height z_e of the tool point [m].", parser=finite_number)
]
RobotName = Annotated[
    str | None,
    typer.Option("--robot", metavar="NAME|URDF", help="Another robot, by name or by the path of its URDF."),
]
NamedConfiguration = Annotated[
    str | None,
    typer.Option("--configuration", metavar="NAME", help="A named configuration of the robot; home by default."),
]
Payload = Annotated[float, typer.Option(min=0.0, metavar="KG", help="A mass at the tool point [kg].", callback=_finite)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to standard output.")]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Parameters of another tripod (YAML); the chapter's by default."),
]


def load_tripod(config: Path | None) -> Tripod:
    """Load the tripod of `--config`, or the chapter's."""
    from pm3dof_pin.chapter.tripod import Tripod

    return Tripod.load(config)


def pose_of(theta_x_deg: float, theta_y_deg: float, z_e: float) -> NDArray[np.float64]:
    """Return the pose (theta_x, theta_y, z_e) in radians and metres, shape=(3,)."""
    import numpy as np

    return np.array([math.radians(theta_x_deg), math.radians(theta_y_deg), z_e])


def payloads_of(robot: Robot, payload: float) -> dict[str, float]:
    """Return the payload of `--payload` [kg] by the frame that carries it, the tool's."""
    return {robot.model.frames[robot.tool_frame_id].name: payload} if payload else {}


@dataclass(frozen=True)
class Target:
    """Which robot, and where: at the pose TX TY Z of the tripod, or in a named configuration of any robot.

    Attributes:
        robot: name, or the path of a URDF.
        pose: theta_x, theta_y [deg], z_e [m], or None.
        name: name of the configuration; None for home, or if there is a pose.
    """

    robot: str
    pose: tuple[float, float, float] | None
    name: str | None

    @classmethod
    def of(
        cls,
        theta_x: float | None,
        theta_y: float | None,
        z_e: float | None,
        robot: str | None,
        configuration: str | None,
    ) -> Target:
        """Check the arguments and options against each other."""
        if theta_x is None or theta_y is None or z_e is None:
            if theta_x is not None:
                raise typer.BadParameter("expected all of TX TY Z, or none of them with --robot or --configuration")
            if robot is None and configuration is None:
                raise typer.BadParameter("expected TX TY Z, or --robot or --configuration")
            return cls(robot or THE_TRIPOD, None, configuration)
        if configuration is not None or robot not in (None, THE_TRIPOD):
            raise typer.BadParameter(
                f"TX TY Z is a pose of {THE_TRIPOD}: expected either it, or --robot and --configuration"
            )
        return cls(THE_TRIPOD, (theta_x, theta_y, z_e), None)

    def configuration(self, mechanism: Robot) -> Configuration:
        """Find the assembled configuration of the robot, once it is loaded."""
        from pm3dof_pin.exceptions import InvalidValueError

        if self.pose is not None:
            return mechanism.solve(pose_of(*self.pose)).configuration()
        named = mechanism.named_configurations
        if self.name is None or (self.name == "home" and not named):
            return mechanism.assemble(mechanism.home)
        if self.name not in named:
            raise InvalidValueError(
                "--configuration", self.name, f"one of {', '.join(named)}" if named else "home, as no other has a name"
            )
        return mechanism.assemble(named[self.name])

    def broken_limits(self, configuration: Configuration) -> list[str]:
        """Say which joint limits are broken, a line for each."""
        if self.pose is not None:
            from pm3dof_pin.chapter.limits import limit_violations

            return [str(violation) for violation in limit_violations(load_tripod(None), pose_of(*self.pose))]
        return [
            f"{broken.name} at {broken.value:.5g}, outside {broken.lower:.5g} .. {broken.upper:.5g} [m, rad]"
            for broken in configuration.violated_limits()
        ]
