"""`pm3dof calibration-plan`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer

from pm3dof_pin.cli.calibrate import MethodName, TargetOffsets
from pm3dof_pin.cli.error_parameters import closing_errors
from pm3dof_pin.cli.options import Json, KnownWrenches, RobotErrorsOptions
from pm3dof_pin.cli.output import print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import Formats, PictureFormat, save

if TYPE_CHECKING:
    from pm3dof_pin.calibration.fit import Method
    from pm3dof_pin.calibration.planning import Plan, PlanningProblem, Strategy

SEEDS = range(10)
COUNTS = (3, 6, 9, 12, 20, 40, 60)
_TRIED = (6, 9, 12, 16, 20, 25, 30, 40, 50, 60, 80, 100)  # numbers of poses tried until an accuracy is reached
_DEFAULT_POSES = 9


_Strategy: TypeAlias = Literal[
    "d-optimal", "tip-optimal", "space-filling", "process-variance", "least-sensitive", "random"
]


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

    from pm3dof_pin.calibration.identifiability import minimum_poses
    from pm3dof_pin.calibration.planning import (
        STRATEGIES,
        STRATEGY_OF_METHOD,
        PlanningProblem,
        order_with_references,
    )
    from pm3dof_pin.errors.source_errors import ErrorSources
    from pm3dof_pin.kinematics.reachable_poses import reachable_poses
    from pm3dof_pin.measuring.instrument import TARGET_RADIUS, TARGET_SIGMA, Instrument
    from pm3dof_pin.measuring.measurement_file import read_plan, write_plan
    from pm3dof_pin.measuring.wrenches import WRENCH_COLUMNS

    if accuracy is not None and (poses is not None or not 0.0 < accuracy < math.inf):
        raise typer.BadParameter("expected a positive --accuracy [m], without --poses")
    whole = not positions and targets is None and not encoder
    if not whole and (accuracy is not None or method != "lm"):
        raise typer.BadParameter("--positions, --targets and --encoder are for --method lm, without --accuracy")
    chosen = strategy or STRATEGY_OF_METHOD[method]
    errors = which.load_errors()
    generator = np.random.default_rng(seed)
    with progress_bar("planning") as progress:
        choices = (
            reachable_poses(errors.robot, candidates, generator, margin=margin)
            if among is None
            else errors.robot.forward(read_plan(among, errors.robot)[0])
        )
        tests = reachable_poses(errors.robot, min(candidates, 300), generator)
        fitting = closing_errors(errors, choices[:20])
        instrument = replace(
            Instrument("position" if positions else "pose"), own_frame=own_frame, encoders=tuple(encoder or ())
        )
        if targets is not None:
            sigma = target_sigma if target_offsets == "estimate" else 0.0
            around = 2.0 * np.pi * np.arange(targets) / targets
            points = TARGET_RADIUS * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
            circle = tuple((float(x), float(y), float(z)) for x, y, z in points)
            instrument = replace(instrument, targets=circle, target_sigma=sigma, position_sigma=TARGET_SIGMA)
        wrenches = None
        if wrench is not None:
            wrenches = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, (len(choices), 6)) * wrench
        problem = PlanningProblem(
            fitting,
            choices,
            tests,
            instrument=instrument,
            min_distance=distance,
            prior=prior,
            wrenches=wrenches,
            sources=ErrorSources(fitting),
        )
        progress(1, 3)
        tried: dict[int, float] = {}
        if whole:
            tried = _rehearsed(problem, chosen, method, poses, accuracy, seed)
        count = max(tried, default=poses or _DEFAULT_POSES)
        plan = problem.plan(count, chosen, np.random.default_rng(seed))
        progress(2, 3)
        others = {name: _predicted(problem, plan, count, name, seed) for name in STRATEGIES}
        loads = {}
        if wrenches is not None:
            columns = zip(WRENCH_COLUMNS, wrenches[plan.indices].T, strict=True)
            loads = {name: values for name, values in columns if values.any()}
        order = np.arange(count) if references is None else order_with_references(plan.poses, references, seed)
        ordered = {name: values[order] for name, values in loads.items()}
        files = [write_plan(plan.poses[order], out, ordered)]
        minimum = minimum_poses(*(rows[: 2 * len(errors)] for rows in (problem.regressor, problem.nuisance_regressor)))
        if picture is not None:
            files += _draw(problem, minimum, picture, formats)
    result = _result(problem, plan, minimum, others)
    result |= {"method": method, "excess_tip_rms_by_poses_m": {str(n): value for n, value in tried.items()}}
    result |= {"accuracy_m": accuracy, "accuracy_reached": None if accuracy is None else tried[count] <= accuracy}
    print_result(result, _lines(result), as_json=as_json, files=files)


def _rehearsed(
    problem: PlanningProblem, strategy: Strategy, method: Method, poses: int | None, accuracy: float | None, seed: int
) -> dict[int, float]:
    """Return the excess tip error over the best commands, by number of poses [m], until one is accurate enough."""
    import numpy as np

    from pm3dof_pin.calibration.fit import MIN_POSES
    from pm3dof_pin.calibration.rehearsal import Rehearsal
    from pm3dof_pin.exceptions import InvalidValueError

    rehearsal = Rehearsal(problem, np.random.default_rng(seed))
    tried: dict[int, float] = {}
    for count in [poses or _DEFAULT_POSES] if accuracy is None else _TRIED:
        if method != "lm" and count < MIN_POSES:
            break
        try:
            plan = problem.plan(count, strategy, np.random.default_rng(seed), restarts=1)
        except InvalidValueError:
            if not tried:
                raise
            break
        tried[count] = rehearsal.excess(plan.indices, method, seed)
        if accuracy is not None and tried[count] <= accuracy:
            break
    return tried


def _predicted(problem: PlanningProblem, plan: Plan, poses: int, strategy: Any, seed: int) -> float:
    """Return the remaining tip error of a strategy [m]; NaN if it has fewer poses to choose from."""
    from pm3dof_pin.exceptions import InvalidValueError

    if strategy == plan.strategy:
        return plan.predicted_tip_rms
    try:
        return float(problem.accuracy_curve([poses], strategy, _seeds(strategy, seed)).mean())
    except InvalidValueError:
        return float("nan")


def _seeds(strategy: Strategy, seed: int = 0) -> Sequence[int]:
    """Return one seed for strategies that hardly depend on it, several to average over for the others."""
    return SEEDS if strategy in ("space-filling", "least-sensitive", "random") else [seed]


def _draw(problem: PlanningProblem, minimum: int, path: Path, formats: list[PictureFormat] | None) -> list[Path]:
    from pm3dof_pin.calibration.planning import STRATEGIES
    from pm3dof_pin.figures.plan_accuracy import plan_accuracy
    from pm3dof_pin.figures.style import save_figure

    curves: dict[str, Any] = {name: problem.accuracy_curve(COUNTS, name, _seeds(name)) for name in STRATEGIES}
    figure = plan_accuracy(COUNTS, curves, minimum)
    return save(figure, path, formats) if formats else [save_figure(figure, path)]


def _result(problem: PlanningProblem, plan: Plan, minimum: int, predicted: dict[Any, float]) -> dict[str, Any]:

    known = plan.identifiability
    units = sorted({command.unit for command in problem.errors.robot.commands})
    return {
        "robot": problem.errors.robot.name,
        "strategy": plan.strategy,
        "poses": len(plan.indices),
        "_".join(["commands", *units]): plan.poses.commands,
        "predicted_tip_rms_m": plan.predicted_tip_rms,
        "tip_rms_before_m": problem.predicted_tip_rms([]),
        "predicted_tip_rms_by_strategy_m": predicted,
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
        "least_number_of_poses": minimum,
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
