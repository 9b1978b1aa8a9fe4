"""`pm3dof calibration-plan`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import typer

from pm3dof_pin.calibration.measurement_plan import (
    CANDIDATES,
    FEWER_CANDIDATES,
    MANY_PARAMETERS,
    MeasurementPlan,
    plan_measurements,
    seeds,
)
from pm3dof_pin.calibration.planning import STRATEGIES, PlanningProblem
from pm3dof_pin.cli.calibrate import MethodName
from pm3dof_pin.cli.error_options import RobotErrorsOptions
from pm3dof_pin.cli.error_parameters import report_dropped
from pm3dof_pin.cli.instrument_options import TRACKER, InstrumentOptions
from pm3dof_pin.cli.options import Json, KnownWrenches
from pm3dof_pin.cli.output import message, print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import Formats, PictureFormat, save
from pm3dof_pin.measuring.plan_file import read_plan, write_plan

COUNTS = (3, 6, 9, 12, 20, 40, 60)

StrategyName: TypeAlias = Literal[
    "d-optimal", "tip-optimal", "space-filling", "process-variance", "least-sensitive", "random"
]
"""Strategies for choosing poses."""


def calibration_plan(
    which: RobotErrorsOptions,
    seen: InstrumentOptions,
    poses: Annotated[int | None, typer.Option(min=1, help="Number of poses to measure (9).")] = None,
    out: Annotated[Path, typer.Option(help="Output file (CSV).")] = Path("results/plan.csv"),
    strategy: Annotated[
        StrategyName | None,
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
    machines: Annotated[
        int,
        typer.Option(min=0, help="Random machines, three tolerances out, to be assembled at every planned pose."),
    ] = 30,
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
    candidates: Annotated[
        int | None,
        typer.Option(
            min=2,
            help=f"Number of random poses to choose from ({CANDIDATES}; {FEWER_CANDIDATES} with more than "
            f"{MANY_PARAMETERS} parameters).",
        ),
    ] = None,
    margin: Annotated[
        float, typer.Option(min=0.0, max=0.4, help="Fraction of each coordinate's range left out at either end.")
    ] = 0.0,
    distance: Annotated[
        float,
        typer.Option(min=0.0, help="Least distance between poses: rms of command differences divided by their ranges."),
    ] = 0.05,
    prior: Annotated[
        float,
        typer.Option(
            help="Prior standard deviation of the parameters but nearly free zeros of drives, in units of their "
            "tolerances."
        ),
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
    if accuracy is not None and (poses is not None or not 0.0 < accuracy < math.inf):
        raise typer.BadParameter("expected a positive --accuracy [m], without --poses")
    if not seen.sees_whole_poses and (accuracy is not None or method != "lm"):
        named = "--instrument, --positions, --targets and --encoder"
        raise typer.BadParameter(f"{named} are for --method lm, without --accuracy")
    errors = which.load_errors()
    with progress_bar("planning") as progress:
        choices = None if among is None else errors.robot.forward(read_plan(among, errors.robot)[0])
        tracks = seen.instrument == TRACKER
        progress(1, 3)
        found = plan_measurements(
            errors,
            poses,
            instrument=seen.tracker() if tracks else seen.instrument,
            **({} if tracks else seen.placing),
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
        report_dropped(errors, found.problem.errors)
        progress(2, 3)
        files = [write_plan(found.poses, out, found.loads)]
        if picture is not None:
            files += _draw(found.problem, found.minimum_poses, picture, formats)
        result = _result(found, seen.instrument)
    result |= {"method": method, "excess_tip_rms_by_poses_m": {str(n): value for n, value in found.excess.items()}}
    result |= {"accuracy_m": accuracy, "accuracy_reached": found.accurate}
    print_result(result, _lines(result), as_json=as_json, files=files)
    if not found.can_be_checked:
        message(
            f"pm3dof: {result['poses']} poses leave nothing to check a calibration by, which will be refused: plan "
            "more (--poses), or identify fewer parameters (error-parameters --preset, then --errors)"
        )
    if found.sag:
        message(f"pm3dof: {found.sag}: a calibration is refused if parameters within their tolerances cannot follow it")


def _draw(problem: PlanningProblem, minimum: int, path: Path, formats: list[PictureFormat] | None) -> list[Path]:
    from pm3dof_pin.figures.plan_accuracy import plan_accuracy
    from pm3dof_pin.figures.style import save_figure

    curves: dict[str, Any] = {name: problem.accuracy_curve(COUNTS, name, seeds(name)) for name in STRATEGIES}
    figure = plan_accuracy(COUNTS, curves, minimum, problem.errors.robot.name)
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
        reached = ", ".join(f"{count}: {1e6 * value:z.1f}" for count, value in excess.items())
        words = "excess tip error over the best commands, rms [µm], simulated on machines within the tolerances"
        rehearsed = ["", f"{words}, method {result['method']}, by number of poses", f"  {reached}"]
        if result["accuracy_reached"] is False:
            rehearsed.append(f"  {1e6 * result['accuracy_m']:z.1f} is not reached: try another --method")
    rows = [[name, "too few poses" if math.isnan(value) else f"{1e6 * value:z.1f}"] for name, value in predicted]
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
        f"before any measurement the tip is known to {1e6 * result['tip_rms_before_m']:z.1f} µm, rms",
        "",
        *table_lines([f"after {result['poses']} poses, method lm", "tip error, rms [µm]"], rows),
        *rehearsed,
    ]


def _stiffness_lines(sigmas: dict[str, float]) -> list[str]:
    if not sigmas:
        return []
    return [f"stiffness known to {', '.join(f'{name} {100.0 * sigma:z.1f} %' for name, sigma in sigmas.items())}"]
