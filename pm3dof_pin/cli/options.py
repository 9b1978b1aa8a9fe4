"""Arguments and options shared by several subcommands, and groups of them that a command takes as one parameter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.cli import completion
from pm3dof_pin.cli.command import NUMBER_OF_VALUES
from pm3dof_pin.cli.output import message
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.kinematics.robot import LoadOptions, Robot
from pm3dof_pin.typing import Engine

THE_TRIPOD = "pm3dof"
ROBOT_VARIABLE = "PM3DOF_ROBOT"
"""Environment variable with the robot of commands without `--robot`."""


def finite_number(text: str) -> float:
    """Read a number; negative numbers arrive as arguments, and so do misspelt options, which are reported as such."""
    try:
        number = float(text)
    except ValueError:
        kind = "neither a number nor an option" if text.startswith("-") else "not a number"
        raise typer.BadParameter(f"{text} is {kind}") from None
    if not math.isfinite(number):
        raise typer.BadParameter(f"{text} is not a finite number")
    return number


def tilt_angle(text: str) -> float:
    """Read the greatest tilt to either side."""
    angle = finite_number(text)
    if not 0.0 < angle <= 180.0:
        raise typer.BadParameter(f"{text} is not an angle above 0 and at most 180 degrees")
    return angle


def _finite(number: float | None) -> float | None:
    if number is not None and not math.isfinite(number):
        raise typer.BadParameter(f"{number} is not a finite number")
    return number


Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to standard output.")]
ColumnsOf = Annotated[
    str | None,
    typer.Option(
        "--columns", metavar="FILE|PROFILE", help="What the file does not say of itself: a YAML file, or a profile."
    ),
]
Out = Annotated[Path, typer.Option(help="Output folder, created if missing.")]
Payload = Annotated[float, typer.Option(min=0.0, metavar="KG", help="Mass at the tool point [kg].", callback=_finite)]
Wrench = Annotated[
    tuple[float, float, float, float, float, float] | None,
    typer.Option(metavar="FX FY FZ MX MY MZ", help="Wrench on the tool, at the tool point, base axes [N, N m]."),
]
KnownWrenches = Annotated[
    tuple[float, float, float, float, float, float] | None,
    typer.Option(
        "--wrench",
        metavar="FX FY FZ MX MY MZ",
        help="Load the tool with known wrenches of up to plus or minus these components [N, N m].",
    ),
]


class _SixNumbers(NamedTuple):
    """A wrench or a twist given as an option."""

    x: float
    y: float
    z: float
    rx: float
    ry: float
    rz: float

    @classmethod
    def parse(cls, text: str) -> _SixNumbers:
        """Read six numbers."""
        numbers = [finite_number(word) for word in text.split()]
        if len(numbers) != NUMBER_OF_VALUES["--wrench"]:
            raise typer.BadParameter(f"expected six numbers, along and about x, y, z, not '{text}'")
        return cls(*numbers)


AppliedWrenches = Annotated[
    list[_SixNumbers] | None,
    typer.Option(
        "--wrench",
        metavar="FX FY FZ MX MY MZ",
        parser=_SixNumbers.parse,
        help="Wrench of the tool on its environment, at the tool point, base axes [N, N m]; may be repeated.",
    ),
]
Twists = Annotated[
    list[_SixNumbers] | None,
    typer.Option(
        "--twist",
        metavar="VX VY VZ WX WY WZ",
        parser=_SixNumbers.parse,
        help="Twist of the tool, of which the greatest multiple is asked [m/s, rad/s]; may be repeated.",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Parameters (YAML) of another machine of the same kind."),
]


def _robot_name(without: str = "") -> Any:
    """Return the option that names a robot; `without` says what happens if it is missing."""
    words = f"Robot, by name or path of its description{without}."
    variable = None if without else ROBOT_VARIABLE
    return typer.Option(metavar="NAME|PATH", help=words, autocompletion=completion.robots, envvar=variable)


_RobotName = Annotated[str | None, _robot_name()]
_RobotNameOrChapter = Annotated[str | None, _robot_name("; without it, the chapter's figures are reproduced")]
_ToolFrame = Annotated[
    str | None, typer.Option(metavar="NAME", help="Frame of the tool; by default the description's.")
]
_PackagePath = Annotated[
    list[Path] | None, typer.Option(metavar="DIR", help="Folder with ROS packages; may be repeated.")
]
_Drives = Annotated[
    str | None,
    typer.Option(
        metavar="JOINT,..", help="The driven joints, in the order of the commands; by default the description's."
    ),
]
_DriveStiffness = Annotated[
    list[str] | None,
    typer.Option(
        metavar="K|JOINT=K,..",
        help="Stiffness of the drives, felt at their joints: of all, or of those named [N/m, N m/rad].",
    ),
]
_HoldBase = Annotated[
    bool | None,
    typer.Option(
        "--hold-base/--float-base",
        help="Whether a floating base is held as at home; by default with --drive-stiffness only.",
        show_default=False,
    ),
]
_XacroArg = Annotated[
    list[str] | None, typer.Option(metavar="NAME:=VALUE", help="Argument of a xacro file; may be repeated.")
]
_Lenient = Annotated[
    bool,
    typer.Option("--lenient", help="Read over elements of the description that could matter and are not understood."),
]
_Pose = Annotated[
    list[float] | None,
    typer.Argument(
        metavar="POSE",
        parser=finite_number,
        help="The robot's coordinates in order, angles [deg], lengths [m]; `pm3dof info` lists them.",
    ),
]
NamedConfiguration = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Named configuration of the robot, instead of a pose; home by default.",
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
    Path | None, typer.Option(metavar="FILE", help="With --poses: output CSV; standard output by default.")
]


@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """The robot, and how its description is read; without `--robot` the chapter's machine, which is said."""

    robot: _RobotName = None
    tool_frame: _ToolFrame = None
    package_path: _PackagePath = None
    drives: _Drives = None
    drive_stiffness: _DriveStiffness = None
    hold_base: _HoldBase = None
    xacro_arg: _XacroArg = None
    lenient: _Lenient = False

    def load(self, engine: Engine = "program", threads: int | None = None) -> Robot:
        """Load the robot."""
        self.announce()
        return Robot.load(self.path, **(self.reading | {"engine": engine, "threads": threads}))

    def announce(self) -> None:
        """Say which robot the answer is about, if none was named."""
        if self.robot is None:
            message(f"pm3dof: no --robot: this is about {THE_TRIPOD}")

    @property
    def path(self) -> str | Path:
        """Name or path that the robot is loaded from."""
        return self.robot or THE_TRIPOD

    @property
    def reading(self) -> LoadOptions:
        """Keyword arguments for reading it; wrong usage ends the command with status 2."""
        return {
            "tool_frame": self.tool_frame,
            "package_paths": self.package_path or (),
            "xacro_args": dict(_xacro_argument(text) for text in self.xacro_arg or ()),
            "lenient": self.lenient,
            "drives": None if self.drives is None else [name.strip() for name in self.drives.split(",")],
            "drive_stiffness": numbers_by_name("--drive-stiffness", self.drive_stiffness),
            "hold_base": self.hold_base,
        }

    @property
    def is_the_tripod(self) -> bool:
        """Whether it is the chapter's machine, which has a closed form."""
        name = self.robot or THE_TRIPOD
        return name == THE_TRIPOD or find_robot(name).path.samefile(find_robot(THE_TRIPOD).path)


@dataclass(frozen=True, kw_only=True)
class MachineOptions(RobotOptions):
    """The robot, or by `--config` another machine of its kind."""

    config: Config = None

    @property
    def path(self) -> str | Path:
        """Name or path that the robot is loaded from; with `--config`, a URDF generated for this process."""
        if self.config is None:
            return super().path
        from pm3dof_pin.export.description import temporary_description  # it loads what one pose does not need

        return temporary_description(self.robot or THE_TRIPOD, self.config)

    def tripod(self) -> Tripod:
        """Load the chapter's machine, or that of `--config`, in closed form."""
        return Tripod.load(self.config)


@dataclass(frozen=True, kw_only=True)
class MachineOrChapterOptions(MachineOptions):
    """The robot; without `--robot`, the chapter's figures are reproduced."""

    robot: _RobotNameOrChapter = None


@dataclass(frozen=True, kw_only=True)
class PlaceOptions:
    """Where the robot is: at a pose or in a named configuration; home by default."""

    pose: _Pose = None
    configuration: NamedConfiguration = None

    @property
    def numbers(self) -> list[float]:
        """The coordinates [deg, m]; empty if the pose is given otherwise."""
        return self.pose or []

    @property
    def is_empty(self) -> bool:
        """Whether nothing was given."""
        return not self.pose and self.configuration is None

    def __post_init__(self) -> None:
        """Check that arguments and options are consistent; wrong usage ends the command with status 2."""
        given = {"POSE": self.pose, "--configuration": self.configuration, "--poses": getattr(self, "poses", None)}
        words = [word for word, value in given.items() if value]
        if len(words) > 1:
            raise typer.BadParameter(f"expected one of {' and '.join(words)}, not both")


@dataclass(frozen=True, kw_only=True)
class PoseOptions(PlaceOptions):
    """Where the robot is: one pose, or many from a file."""

    poses: _PosesFile = None
    out: OutFile = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing was given."""
        return super().is_empty and self.poses is None

    def __post_init__(self) -> None:
        """Check that arguments and options are consistent; wrong usage ends the command with status 2."""
        super().__post_init__()
        if self.out is not None and self.poses is None:
            raise typer.BadParameter("--out requires --poses")


def _xacro_argument(text: str) -> tuple[str, str]:
    name, separator, value = text.partition(":=")
    if not (name and separator):
        raise typer.BadParameter(f"--xacro-arg {text}: expected NAME:=VALUE")
    return name, value


def numbers_by_name(option: str, texts: list[str] | str | None) -> float | dict[str, float] | None:
    """Read one number for all drives, or numbers by joint; wrong usage ends the command with status 2."""
    given = [texts] if isinstance(texts, str) else texts or ()
    entries = [entry.strip() for text in given for entry in text.split(",")]
    if len(entries) == 1 and "=" not in entries[0]:
        return finite_number(entries[0])
    if wrong := [entry for entry in entries if not all(entry.partition("="))]:
        raise typer.BadParameter(f"{option} {wrong[0]}: expected one number, or JOINT=NUMBER for each drive")
    names = [entry.partition("=")[0] for entry in entries]
    if twice := [name for name in names if names.count(name) > 1]:
        raise typer.BadParameter(f"{option} names {twice[0]} twice")
    return {name: finite_number(value) for name, _, value in (entry.partition("=") for entry in entries)} or None


def payloads_of(robot: Robot, payload: float) -> dict[str, float]:
    """Return `--payload` [kg] by the frame that carries it: the tool frame."""
    return {robot.frame_name(): payload} if payload else {}
