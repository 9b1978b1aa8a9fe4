"""What measures: options of the commands that plan measurements and that simulate them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import typer

from pm3dof_pin.cli.command import NUMBER_OF_VALUES
from pm3dof_pin.cli.options import finite_number
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.instrument import TARGET_SIGMA, Instrument, circle_of_targets
from pm3dof_pin.measuring.instruments.table import INSTRUMENTS, placed_instrument

Place: TypeAlias = tuple[float, float, float]
"""A point given as an option, in the axes of the tool or of the base [m]."""

TargetOffsets: TypeAlias = Literal["fixed", "estimate"]
"""Whether target positions are estimated or taken from the file."""

TRACKER, LOCK = "tracker", "lock"


class PlaceNumbers(NamedTuple):
    """A point given as an option that may be repeated, base axes [m]."""

    x: float
    y: float
    z: float

    @classmethod
    def parse(cls, text: str) -> PlaceNumbers:
        """Read X Y Z."""
        words = text.split()
        if len(words) != NUMBER_OF_VALUES["--centre"]:
            raise typer.BadParameter(f"expected X Y Z, not '{text}'")
        return cls(*map(finite_number, words))


def _name(text: str) -> str:
    if text not in INSTRUMENTS:
        raise typer.BadParameter(f"'{text}' is not one of {', '.join(INSTRUMENTS)}")
    return text


_Instrument = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        parser=_name,
        autocompletion=lambda incomplete: [name for name in INSTRUMENTS if name.startswith(incomplete)],
        help=f"What measures: {', '.join(INSTRUMENTS)}.",
    ),
]
_Centre = Annotated[
    list[PlaceNumbers] | None,
    typer.Option(
        metavar="X Y Z",
        parser=PlaceNumbers.parse,
        help="Where the instrument is about, base axes [m]: socket, plane, line, camera; for wires repeated.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class InstrumentOptions:
    """What measures, and where it stands; a laser tracker by default."""

    instrument: _Instrument = TRACKER
    point: Annotated[
        Place | None,
        typer.Option(metavar="X Y Z", help="The ball, stylus or target, in tool axes [m]; the tool point by default."),
    ] = None
    centre: _Centre = None
    known_centres: Annotated[
        bool, typer.Option("--known-centres", help="The --centre of wires or ballbar were measured beforehand.")
    ] = False
    length: Annotated[float | None, typer.Option(metavar="METRES", help="Length of a ballbar (0.15).")] = None
    sigma: Annotated[
        float | None,
        typer.Option(
            "--sigma",
            "--noise",
            min=1e-9,
            help="Noise: of each coordinate of a tracker's target, of a distance, a touch [m], a tilt [rad].",
        ),
    ] = None
    positions: Annotated[
        bool, typer.Option("--positions", help="The instrument measures positions only, not full poses.")
    ] = False
    own_frame: Annotated[
        bool, typer.Option("--own-frame", help="The instrument's frame is its own, located from the measurements.")
    ] = False
    targets: Annotated[
        int | None,
        typer.Option(min=1, help="Number of targets, measured one by one, 0.15 m around the tool point."),
    ] = None
    target_offsets: Annotated[
        TargetOffsets, typer.Option(help="Target positions are estimated, or known and fixed.")
    ] = "estimate"
    target_sigma: Annotated[
        float, typer.Option(min=1e-9, help="Standard deviation of the target positions, per coordinate [m].")
    ] = 1e-3
    encoder: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT",
            help="A passive joint with an encoder that is also read, or that is locked; may be repeated.",
        ),
    ] = None

    def __post_init__(self) -> None:
        """Check that the options go together; wrong usage ends the command with status 2."""
        placed = self.point is not None or self.centre or self.length is not None or self.known_centres
        if self.instrument == TRACKER and placed:
            words = "--point, --centre, --known-centres and --length"
            raise typer.BadParameter(f"{words} are for other instruments than a tracker")
        of_tracker = self.positions or self.targets is not None or self.own_frame
        if self.instrument != TRACKER and (of_tracker or (self.encoder and self.instrument != LOCK)):
            words = "--positions, --own-frame, --targets and --encoder"
            raise typer.BadParameter(f"{words} are for --instrument tracker, --encoder also for lock")

    @property
    def is_partial(self) -> bool:
        """Whether a tracker sees anything but full poses."""
        return self.positions or self.targets is not None or bool(self.encoder)

    @property
    def sees_whole_poses(self) -> bool:
        """Whether a pose is measured whole."""
        return self.instrument == TRACKER and not self.is_partial

    @property
    def placing(self) -> dict[str, Any]:
        """Keyword arguments that place an instrument of a name."""
        return {
            "sigma": self.sigma,
            "point": self.point,
            "centres": tuple((place.x, place.y, place.z) for place in self.centre or ()),
            "known_centres": self.known_centres,
            "length": self.length,
            "joints": tuple(self.encoder or ()),
            "target_sigma": self._target_sigma,
        }

    def placed(self, poses: Poses) -> Instrument:
        """Return the instrument, placed where it sees or touches poses."""
        if self.instrument == TRACKER:
            return self.tracker()
        return placed_instrument(self.instrument, poses, **self.placing)

    def tracker(self) -> Instrument:
        """Return a tracker that sees as much as the options say."""
        one = TARGET_SIGMA if self.sigma is None else self.sigma
        seen = replace(
            Instrument.with_targets(one),
            measured="position" if self.positions else "pose",
            own_frame=self.own_frame,
            encoders=tuple(self.encoder or ()),
        )
        if self.targets is None:
            return seen
        targets = circle_of_targets(self.targets)
        return replace(seen, targets=targets, target_sigma=self._target_sigma, position_sigma=one)

    @property
    def _target_sigma(self) -> float:
        return self.target_sigma if self.target_offsets == "estimate" else 0.0
