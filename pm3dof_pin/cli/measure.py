"""`pm3dof measure`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from pm3dof_pin.cli.error_options import RobotErrorsOptions
from pm3dof_pin.cli.instrument_options import InstrumentOptions
from pm3dof_pin.cli.options import Json, KnownWrenches
from pm3dof_pin.cli.output import message, print_result
from pm3dof_pin.errors.pose_error import rotation_matrix
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import ConvergenceError, OutputError, PM3DofError, UnreachablePoseError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurement_file import write_measurements
from pm3dof_pin.measuring.plan_file import read_plan
from pm3dof_pin.measuring.registration import Registration
from pm3dof_pin.simulation.worlds import World
from pm3dof_pin.typing import Array, Mask

_POSES = 60
_STANDING, _AWAY = 1, 10.0  # of the random numbers; times the machine's size


def measure(
    which: RobotErrorsOptions,
    seen: InstrumentOptions,
    out: Annotated[Path, typer.Option(help="Output file (CSV).")] = Path("results/measurements.csv"),
    poses: Annotated[
        int | None, typer.Option(min=1, help="Number of random poses within all joint limits (60).")
    ] = None,
    plan: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Measure at the commands of a `calibration-plan` instead.")
    ] = None,
    world: Annotated[
        Literal["everything", "geometry"],
        typer.Option(help="geometry: only the error file's parameters are off; everything: all sources of error."),
    ] = "everything",
    only: Annotated[
        Literal["geometric", "waviness", "thermal", "elastic", "vibration"] | None,
        typer.Option(help="Keep only one source of error."),
    ] = None,
    load: Annotated[float, typer.Option(min=0.0, help="Hang known weights of up to this force on the tool [N].")] = 0.0,
    wrench: KnownWrenches = None,
    large: Annotated[
        bool, typer.Option("--large", help="Large deflections: solve the equilibrium under the loads at each pose.")
    ] = False,
    machine: Annotated[int, typer.Option(min=0, help="Seed of the machine; the same seed gives the same machine.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the poses, temperatures and noise.")] = 0,
    force: Annotated[bool, typer.Option("--force", help="Replace the output file if it exists.")] = False,
    as_json: Json = False,
) -> None:
    """Simulate measurements of a machine with errors, as a file for `calibrate`. Lengths in metres.

    A file that exists is kept: it may hold real measurements.
    """
    if poses is not None and plan is not None:
        raise typer.BadParameter("expected --poses or --plan, not both")
    if out.exists() and not force:
        raise OutputError(out, "exists and may hold real measurements: use --force to replace it by simulated ones")
    errors = which.load_errors()
    generator = np.random.default_rng(seed)
    sample = reachable_poses(errors.robot, poses or _POSES, generator)
    commands, given = (sample.commands, None) if plan is None else read_plan(plan, errors.robot)
    nominal = sample if plan is None else errors.robot.forward(commands)
    fitting = closable(errors, sample[:20])
    truth = World.random(world, fitting, np.random.default_rng(machine)).loaded(load, wrench or (0.0,) * 6, large=large)
    if only is not None:
        truth = truth.only(only)
    instrument = seen.placed(nominal)
    before = generator.bit_generator.state
    try:
        measurements = truth.measure(commands, generator, instrument, given)
    except (ConvergenceError, UnreachablePoseError):
        generator.bit_generator.state, taken = before, _taken(truth, commands)
        left = int((~taken).sum())
        if not left:
            raise
        problem = f"{left} of {len(commands)} poses are left out because this machine cannot be assembled there"
        if left == len(commands):
            raise UnreachablePoseError(problem) from None
        message(f"pm3dof: {problem}")
        given = given and {name: values[taken] for name, values in given.items()}
        measurements = truth.measure(commands[taken], generator, instrument, given)
    if seen.own_frame:
        measurements = measurements.in_axes(_standing(machine, errors.robot))
    path = write_measurements(measurements, errors.robot, out)
    result = {"robot": errors.robot.name, "file": str(path), "poses": len(measurements)}
    result |= {"measured": measurements.measured, "machine": machine, "instrument": seen.instrument}
    rows = "poses" if seen.sees_whole_poses else f"rows ({seen.instrument})"
    print_result(result, [f"{len(measurements)} {rows} of machine {machine}, world '{world}'"], as_json=as_json)
    message(f"wrote {path}")


def _standing(machine: int, robot: Robot) -> Registration:
    """Return where a tracker of its own frame stands: level, some metres away, turned anyhow."""
    generator = np.random.default_rng([machine, _STANDING])
    turn = rotation_matrix(generator.uniform(-np.pi, np.pi) * np.eye(3)[2])
    away = generator.uniform(-1.0, 1.0, 3) * _AWAY * robot.characteristic_length
    return Registration(turn, away, 0.0)


def _taken(truth: World, commands: Array) -> Mask:
    """Tell which commands the machine can reach, shape=(n,): near singular poses, fewer than the nominal one can."""

    def takes(command: Array) -> bool:
        try:
            truth.poses(command[None], {})
        except PM3DofError:
            return False
        return True

    return np.array([takes(command) for command in commands])
