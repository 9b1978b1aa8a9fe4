"""`pm3dof calibration-plan`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeAlias

import typer

from pm3dof_pin.cli.calibrate import MethodName, TargetOffsets
from pm3dof_pin.cli.error_parameters import closing_errors
from pm3dof_pin.cli.options import Json, KnownWrenches, RobotErrorsOptions, finite_number
from pm3dof_pin.cli.output import message, print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import Formats, PictureFormat, save

if TYPE_CHECKING:
    from pm3dof_pin.calibration.measurement_plan import MeasurementPlan
    from pm3dof_pin.calibration.planning import PlanningProblem

COUNTS = (3, 6, 9, 12, 20, 40, 60)
_Point: TypeAlias = tuple[float, float, float]
_Instrument: TypeAlias = Literal["tracker", "ballbar", "wires", "probe", "gauge", "line", "socket", "camera", "level"]


_Strategy: TypeAlias = Literal[
    "d-optimal", "tip-optimal", "space-filling", "process-variance", "least-sensitive", "random"
]


class _Place(NamedTuple):
    x: float
    y: float
    z: float

    @classmethod
    def parse(cls, text: str) -> _Place:
        """Read X Y Z."""
        words = text.split()
        if len(words) != len(cls._fields):
            raise typer.BadParameter(f"expected X Y Z, not '{text}'")
        return cls(*map(finite_number, words))


def calibration_plan(
    which: RobotErrorsOptions,
    poses: Annotated[int | None, typer.Option(min=1, help="Number of poses to measure (9).")] = None,
    out: Annotated[Path, typer.Option(help="Output file (CSV).")] = Path("results/plan.csv"),
    strategy: Annotated[
        _Strategy | None,
        typer.Option(
            help="Strategy for choosing poses; by default that of --method. least-sensitive is the chapter's rule; "
            "d-optimal and tip-optimal suit parameters, space-filling and process-variance suit learned corrections."
        ),
    ] = None,
    method: Annotated[
        MethodName,
        typer.Option(help="Calibration method to plan for: lm (parameters), nn or gp (learned), or both."),
    ] = "lm",
    accuracy: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Choose enough poses to bring the excess tip error over the best commands below this [m, rms].",
        ),
    ] = None,
    instrument: Annotated[
        _Instrument,
        typer.Option(help="What measures: full poses, or distances, touches, heights, image points, tilts."),
    ] = "tracker",
    point: Annotated[
        _Point | None,
        typer.Option(metavar="X Y Z", help="The ball, stylus or target, in tool axes [m]; the tool point by default."),
    ] = None,
    centre: Annotated[
        list[_Place] | None,
        typer.Option(
            metavar="X Y Z",
            parser=_Place.parse,
            help="Where the instrument is about, base axes [m]: socket, plane, line, camera; for wires repeated.",
        ),
    ] = None,
    known_centres: Annotated[
        bool, typer.Option("--known-centres", help="The --centre of wires or ballbar were measured beforehand.")
    ] = False,
    length: Annotated[float | None, typer.Option(metavar="METRES", help="Length of a ballbar (0.15).")] = None,
    sigma: Annotated[
        float | None, typer.Option(min=1e-9, help="Noise of the instrument [m], of a level [rad]; else a usual one.")
    ] = None,
    machines: Annotated[
        int,
        typer.Option(min=0, help="Random machines, three tolerances out, to be assembled at every planned pose."),
    ] = 30,
    positions: Annotated[
        bool, typer.Option("--positions", help="The instrument measures positions only, not full poses.")
    ] = False,
    own_frame: Annotated[
        bool, typer.Option("--own-frame", help="The instrument's frame is its own, located from the measurements.")
    ] = False,
    targets: Annotated[
        int | None,
        typer.Option(min=1, help="Number of targets, measured one by one, 0.15 m around the tool point."),
    ] = None,
    target_offsets: Annotated[
        TargetOffsets, typer.Option(help="Target positions are estimated, or known and fixed.")
    ] = "estimate",
    target_sigma: Annotated[
        float, typer.Option(min=1e-9, help="Standard deviation of the target positions, per coordinate [m].")
    ] = 1e-3,
    encoder: Annotated[
        list[str] | None,
        typer.Option(metavar="JOINT", help="A passive joint with an encoder that is also read; may be repeated."),
    ] = None,
    wrench: KnownWrenches = None,
    among: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Choose among the commands in a CSV file, such as the least_sensitive.csv of error-map --budget.",
        ),
    ] = None,
    references: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Order the poses at random and repeat one pose first, after every N others, and last, to show drift.",
        ),
    ] = None,
    candidates: Annotated[int, typer.Option(min=2, help="Number of random poses to choose from.")] = 2000,
    margin: Annotated[
        float, typer.Option(min=0.0, max=0.4, help="Fraction of each coordinate's range left out at either end.")
    ] = 0.0,
    distance: Annotated[
        float,
        typer.Option(min=0.0, help="Least distance between poses: rms of command differences divided by their ranges."),
    ] = 0.05,
    prior: Annotated[
        float, typer.Option(help="Prior standard deviation of the parameters, in units of their tolerances.")
    ] = 3.0,
    seed: Annotated[int, typer.Option(min=0, help="Random seed; the same seed gives the same plan.")] = 0,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the predicted accuracy against the number of poses (.png, .pdf, .svg).")
    ] = None,
    formats: Formats = None,
    as_json: Json = False,
) -> None:
    """Choose poses to measure for a calibration, within all joint limits, and predict its accuracy.

    Lengths in metres. With known wrenches, the spring stiffnesses are identified too.
    """
    from dataclasses import replace

    import numpy as np

    from pm3dof_pin.calibration.measurement_plan import plan_measurements
    from pm3dof_pin.measuring.instrument import TARGET_RADIUS, TARGET_SIGMA, Instrument
    from pm3dof_pin.measuring.measurement_file import read_plan, write_plan

    if accuracy is not None and (poses is not None or not 0.0 < accuracy < math.inf):
        raise typer.BadParameter("expected a positive --accuracy [m], without --poses")
    partial = positions or targets is not None or bool(encoder)
    tracked = partial or own_frame
    if (partial or instrument != "tracker") and (accuracy is not None or method != "lm"):
        named = "--instrument, --positions, --targets and --encoder"
        raise typer.BadParameter(f"{named} are for --method lm, without --accuracy")
    if tracked and instrument != "tracker":
        raise typer.BadParameter("--positions, --own-frame, --targets and --encoder are for --instrument tracker")
    if instrument == "tracker" and (point is not None or centre or length is not None or sigma is not None):
        raise typer.BadParameter("--point, --centre, --length and --sigma are for other instruments than a tracker")
    errors = which.load_errors()
    with progress_bar("planning") as progress:
        choices = None if among is None else errors.robot.forward(read_plan(among, errors.robot)[0])
        fitting = closing_errors(errors, None if choices is None else choices[:20])
        seen: Any = instrument
        if tracked:
            seen = replace(
                Instrument("position" if positions else "pose"), own_frame=own_frame, encoders=tuple(encoder or ())
            )
        if targets is not None:
            target = target_sigma if target_offsets == "estimate" else 0.0
            around = 2.0 * np.pi * np.arange(targets) / targets
            points = TARGET_RADIUS * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
            circle = tuple((float(x), float(y), float(z)) for x, y, z in points)
            seen = replace(seen, targets=circle, target_sigma=target, position_sigma=TARGET_SIGMA)
        progress(1, 3)
        found = plan_measurements(
            fitting,
            poses,
            instrument=seen,
            sigma=sigma,
            point=point,
            centres=tuple((place.x, place.y, place.z) for place in centre or ()),
            known_centres=known_centres,
            length=length,
            method=method,
            strategy=strategy,
            accuracy=accuracy,
            among=choices,
            candidates=candidates,
            margin=margin,
            min_distance=distance,
            prior=prior,
            wrench=wrench,
            references=references,
            machines=machines,
            seed=seed,
        )
        progress(2, 3)
        files = [write_plan(found.poses, out, found.loads)]
        if picture is not None:
            files += _draw(found.problem, found.minimum_poses, picture, formats)
        result = _result(found, instrument)
    result |= {"method": method, "excess_tip_rms_by_poses_m": {str(n): value for n, value in found.excess.items()}}
    result |= {"accuracy_m": accuracy, "accuracy_reached": found.accurate}
    print_result(result, _lines(result), as_json=as_json, files=files)
    if not found.can_be_checked:
        message(
            f"pm3dof: {result['poses']} poses leave nothing to check a calibration by, which will be refused: plan "
            "more (--poses), or identify fewer parameters (error-parameters --preset, then --errors)"
        )


def _draw(problem: PlanningProblem, minimum: int, path: Path, formats: list[PictureFormat] | None) -> list[Path]:
    from pm3dof_pin.calibration.measurement_plan import seeds
    from pm3dof_pin.calibration.planning import STRATEGIES
    from pm3dof_pin.figures.plan_accuracy import plan_accuracy
    from pm3dof_pin.figures.style import save_figure

    curves: dict[str, Any] = {name: problem.accuracy_curve(COUNTS, name, seeds(name)) for name in STRATEGIES}
    figure = plan_accuracy(COUNTS, curves, minimum)
    return save(figure, path, formats) if formats else [save_figure(figure, path)]


def _result(found: MeasurementPlan, instrument: str) -> dict[str, Any]:
    problem, plan = found.problem, found.plan
    known = plan.identifiability
    units = sorted({command.unit for command in problem.errors.robot.commands})
    return {
        "robot": problem.errors.robot.name,
        "instrument": instrument,
        "strategy": plan.strategy,
        "poses": len(plan.indices),
        "_".join(["commands", *units]): plan.poses.commands,
        "predicted_tip_rms_m": plan.predicted_tip_rms,
        "tip_rms_before_m": problem.predicted_tip_rms([]),
        "predicted_tip_rms_by_strategy_m": found.by_strategy,
        "parameters": len(problem.unknowns),
        "predicted_stiffness_sigma_of_logarithm": {
            name.removesuffix(".ln_k"): sigma
            for name, sigma in problem.predicted_sigmas(plan.indices).items()
            if name not in problem.errors.names
        },
        "identifiable": known.rank,
        "estimated_beside_them": list(dict.fromkeys(part.kind for part in problem.nuisances.parts)),
        "rank_gap": known.decision.gap,
        "better_known_than_tolerances": known.identified,
        "not_identifiable": known.unidentifiable,
        "not_identified": known.unidentified,
        "least_number_of_poses": found.minimum_poses,
        "machines_assembled": found.machines,
        "candidates_near_singular": found.near_singular,
        "candidates_not_assembled": found.not_assembled,
        "observability": known.observability.__dict__,
    }


def _lines(result: dict[str, Any]) -> list[str]:
    hidden = result["not_identified"]
    observability = ", ".join(f"{name} = {value:.3g}" for name, value in result["observability"].items())
    predicted = result["predicted_tip_rms_by_strategy_m"].items()
    excess = {int(count): value for count, value in result["excess_tip_rms_by_poses_m"].items()}
    rehearsed = []
    if excess:
        reached = ", ".join(f"{count}: {1e6 * value:.1f}" for count, value in excess.items())
        words = "excess tip error over the best commands, rms [µm], simulated on machines within the tolerances"
        rehearsed = ["", f"{words}, method {result['method']}, by number of poses", f"  {reached}"]
        if result["accuracy_reached"] is False:
            rehearsed.append(f"  {1e6 * result['accuracy_m']:.1f} is not reached: try another --method")
    rows = [[name, "too few poses" if math.isnan(value) else f"{1e6 * value:.1f}"] for name, value in predicted]
    beside = result["estimated_beside_them"]
    return [
        f"{result['robot']}: {result['poses']} poses, {result['strategy']}, for method {result['method']}"
        + (f", {result['instrument']}" if result["instrument"] != "tracker" else "")
        + (f"; also estimated: {', '.join(beside)}" if beside else ""),
        f"{result['better_known_than_tolerances']} of {result['parameters']} parameters identified better than their "
        f"tolerances, {result['identifiable']} have an effect; to see all effects takes "
        f"{result['least_number_of_poses']} poses",
        f"not identified: {'; '.join(hidden[:3]) or 'nothing'}{f'; {len(hidden) - 3} more' if len(hidden) > 3 else ''}",
        *_stiffness_lines(result["predicted_stiffness_sigma_of_logarithm"]),
        f"observability {observability}",
        f"before any measurement the tip is known to {1e6 * result['tip_rms_before_m']:.1f} µm, rms",
        "",
        *table_lines([f"after {result['poses']} poses, method lm", "tip error, rms [µm]"], rows),
        *rehearsed,
    ]


def _stiffness_lines(sigmas: dict[str, float]) -> list[str]:
    if not sigmas:
        return []
    return [f"stiffness known to {', '.join(f'{name} {100.0 * sigma:.1f} %' for name, sigma in sigmas.items())}"]
