"""Arguments and options that several subcommands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.kinematics.robot import Robot

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


Payload = Annotated[float, typer.Option(min=0.0, metavar="KG", help="A mass at the tool point [kg].", callback=_finite)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to standard output.")]


def is_the_tripod(robot: str) -> bool:
    """Tell whether a name or path is that of the chapter's machine, of which more is known in closed form."""
    from pm3dof_pin.description.robots import find_robot

    return robot == THE_TRIPOD or find_robot(robot).path.samefile(find_robot(THE_TRIPOD).path)


def load_tripod(config: Path | None) -> Tripod:
    """Load the tripod of `--config`, or the chapter's."""
    from pm3dof_pin.chapter.tripod import Tripod

    return Tripod.load(config)


def payloads_of(robot: Robot, payload: float) -> dict[str, float]:
    """Return the payload of `--payload` [kg] by the frame that carries it, the tool's."""
    return {robot.model.frames[robot.tool_frame_id].name: payload} if payload else {}


Wrench = Annotated[
    tuple[float, float, float, float, float, float] | None,
    typer.Option(
        metavar="FX FY FZ MX MY MZ",
        help="Wrench on the tool, at the tool point, axes of the base [N, N m].",
    ),
]
