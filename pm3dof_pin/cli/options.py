"""Arguments and options that several subcommands share, and groups of them that a command takes as one parameter."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from pm3dof_pin.cli import completion

if TYPE_CHECKING:
    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.errors.error_parameters import GeometricErrors
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


Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to standard output.")]
Out = Annotated[Path, typer.Option(help="Folder to write to; made if it is not there.")]
Payload = Annotated[float, typer.Option(min=0.0, metavar="KG", help="A mass at the tool point [kg].", callback=_finite)]
Wrench = Annotated[
    tuple[float, float, float, float, float, float] | None,
    typer.Option(metavar="FX FY FZ MX MY MZ", help="Wrench on the tool, at the tool point, axes of the base [N, N m]."),
]
KnownWrenches = Annotated[
    tuple[float, float, float, float, float, float] | None,
    typer.Option(
        "--wrench",
        metavar="FX FY FZ MX MY MZ",
        help="Load the tool with known wrenches, each component between minus and plus so much [N, N m].",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Parameters (YAML) for another machine of the robot's kind."),
]


def _robot_name(without: str = "") -> Any:
    """Return the option that names a robot, saying what happens without it."""
    words = f"A robot, by name or by the path of its description{without}."
    return typer.Option(metavar="NAME|PATH", help=words, autocompletion=completion.robots)


_RobotName = Annotated[str, _robot_name()]
_RobotNameOrChapter = Annotated[str | None, _robot_name("; without it, the chapter's picture of its machine")]
_ToolFrame = Annotated[
    str | None, typer.Option(metavar="NAME", help="Frame of the tool; by default the description's.")
]
_PackagePath = Annotated[
    list[Path] | None, typer.Option(metavar="DIR", help="Folder that ROS packages are in; may be repeated.")
]
_ErrorFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        exists=True,
        dir_okay=False,
        help="What may sit wrong (YAML), in place of the robot's own file; `pm3dof error-parameters` writes one.",
    ),
]
_Pose = Annotated[
    list[float] | None,
    typer.Argument(
        metavar="POSE",
        parser=finite_number,
        help="The robot's coordinates in their order, angles [deg], lengths [m]; `pm3dof info` names them.",
    ),
]
NamedConfiguration = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="A named configuration of the robot instead of numbers; home by default.",
        autocompletion=completion.configurations,
    ),
]
_PosesFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Many poses: CSV with a column NAME_deg, NAME_rad or NAME_m for each coordinate."
    ),
]
OutFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="With --poses: CSV to write; by default to standard output.")
]


@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """Which robot, by `--robot`, `--tool-frame` and `--package-path`."""

    robot: _RobotName = THE_TRIPOD
    tool_frame: _ToolFrame = None
    package_path: _PackagePath = None

    def load(self) -> Robot:
        """Load the robot."""
        from pm3dof_pin.kinematics.robot import Robot

        return Robot.load(self.path, **self.reading)

    def load_errors(self) -> GeometricErrors:
        """Load the robot with all its error parameters."""
        from pm3dof_pin.errors.error_parameters import GeometricErrors

        return GeometricErrors.load(self.robot, **self.reading)

    @property
    def path(self) -> str | Path:
        """What the robot is loaded from."""
        return self.robot

    @property
    def reading(self) -> dict[str, Any]:
        """How it is read."""
        return {"tool_frame": self.tool_frame, "package_paths": self.package_path or ()}

    @property
    def is_the_tripod(self) -> bool:
        """Whether it is the chapter's machine, of which more is known in closed form."""
        from pm3dof_pin.description.robots import find_robot

        return self.robot == THE_TRIPOD or find_robot(self.robot).path.samefile(find_robot(THE_TRIPOD).path)


@dataclass(frozen=True, kw_only=True)
class RobotErrorsOptions(RobotOptions):
    """Which robot, and by `--errors` what may sit wrong in it."""

    errors: _ErrorFile = None

    def load_errors(self) -> GeometricErrors:
        """Load the robot with the error parameters of the file, or else with its own."""
        if self.errors is None:
            return super().load_errors()
        from pm3dof_pin.errors.error_parameters import GeometricErrors

        return GeometricErrors.of(self.load(), self.errors)


@dataclass(frozen=True, kw_only=True)
class MachineOptions(RobotOptions):
    """Which robot, or by `--config` which machine of its kind."""

    config: Config = None

    @property
    def path(self) -> str | Path:
        """What the robot is loaded from; with `--config` a URDF that is made for this process."""
        if self.config is None:
            return self.robot or THE_TRIPOD
        from pm3dof_pin.export.description import temporary_description

        return temporary_description(self.robot or THE_TRIPOD, self.config)

    def tripod(self) -> Tripod:
        """Load the chapter's machine, or that of `--config`, in closed form."""
        from pm3dof_pin.chapter.tripod import Tripod

        return Tripod.load(self.config)


@dataclass(frozen=True, kw_only=True)
class MachineOrChapterOptions(MachineOptions):
    """Which robot; without `--robot` the command makes the chapter's picture."""

    robot: _RobotNameOrChapter = None  # type: ignore[assignment]


@dataclass(frozen=True, kw_only=True)
class PlaceOptions:
    """Where the robot stands: at a pose, or in a named configuration; by default at home."""

    pose: _Pose = None
    configuration: NamedConfiguration = None

    @property
    def numbers(self) -> list[float]:
        """The coordinates [deg, m]; none if the pose is given otherwise."""
        return self.pose or []

    @property
    def is_empty(self) -> bool:
        """Whether nothing was given."""
        return not self.pose and self.configuration is None

    def __post_init__(self) -> None:
        """Check arguments and options against each other; wrong usage ends the command with status 2."""
        given = {"POSE": self.pose, "--configuration": self.configuration, "--poses": getattr(self, "poses", None)}
        words = [word for word, value in given.items() if value]
        if len(words) > 1:
            raise typer.BadParameter(f"expected one of {' and '.join(words)}, not both")


@dataclass(frozen=True, kw_only=True)
class PoseOptions(PlaceOptions):
    """Where the robot stands: also at many poses of a file."""

    poses: _PosesFile = None
    out: OutFile = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing was given."""
        return super().is_empty and self.poses is None

    def __post_init__(self) -> None:
        """Check arguments and options against each other; wrong usage ends the command with status 2."""
        super().__post_init__()
        if self.out is not None and self.poses is None:
            raise typer.BadParameter("--out is for the poses of --poses")


def with_groups(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose parameters of a group's type are replaced by the options of the group."""
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        group = groups.get(parameter.name)
        if group is None:
            parameters.append(parameter.replace(annotation=hints[parameter.name], kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        kinds = get_type_hints(group, include_extras=True)
        parameters += [
            inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=kinds[f.name])
            for f in fields(group)
        ]

    @functools.wraps(function)
    def command(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        function(**given)

    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    del command.__wrapped__
    return command


def payloads_of(robot: Robot, payload: float) -> dict[str, float]:
    """Return the payload of `--payload` [kg] by the frame that carries it, the tool's."""
    return {robot.frame_name(): payload} if payload else {}
