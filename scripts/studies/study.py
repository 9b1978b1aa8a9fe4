"""Which method, with how many poses? A study on simulated machines with more errors than any model describes.

For each seed a machine is drawn and measured at random poses, or at those that another strategy of
:mod:`pm3dof_pin.calibration.planning` chooses; every method is given the first 6, 9 ... of them (for another strategy a
plan for each number) and then commands the machine to unseen poses: held-out ones all over the workspace, and an outer
shell of it. The errors there are the machine's own, without measurement noise, compared with those of the best possible
commands (the floor).

Worlds: everything that :class:`~pm3dof_pin.simulation.worlds.World` knows; the same, measured in the inner half of the
workspace only; and a machine with geometric errors only, on which a learned correction must do no harm.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.fit import METHODS, Method, Options, compensation_from
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.calibration.planning import PlanningProblem, Strategy
from pm3dof_pin.errors.command_correction import best_commands, command_jacobians
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error, tip_weights, weighted_energy
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.simulation.worlds import World
from pm3dof_pin.typing import Array

StudyWorld = Literal["everything", "inner half", "geometry"]
STUDY_WORLDS: tuple[StudyWorld, ...] = get_args(StudyWorld)
TESTS = ("held out", "outer shell")
NONE, FLOOR = "none", "floor"
ROWS = (NONE, *METHODS, FLOOR)
"""The compared rows: no correction, the methods, the best possible commands."""

_SHELL = 0.8  # share of the poses inside the outer shell
_INNER = 0.5
_RESTARTS = 3  # of the exchange that finds optimal poses
_PLANNED_FOR = 200  # poses over which plans make errors small
_POOL = 10  # candidates for each pose of the shell


@dataclass(frozen=True)
class StudyPlan:
    """The cases of a study.

    Attributes:
        robot: name or path.
        seeds: one machine each, for each world.
        counts: numbers of poses measured.
        worlds: see the module.
        strategies: how the measured poses are chosen.
        methods: of the calibration.
        candidates: poses that strategies choose from.
        test_poses: number of held-out poses.
        shell_poses: number of poses in the outer shell.
        target_sigma: noise of each coordinate of a tracker's target [m].
    """

    robot: str = "pm3dof"
    seeds: tuple[int, ...] = tuple(range(10))
    counts: tuple[int, ...] = (6, 9, 12, 20, 35, 60, 100)
    worlds: tuple[StudyWorld, ...] = STUDY_WORLDS
    strategies: tuple[Strategy, ...] = ("random",)
    methods: tuple[Method, ...] = METHODS
    candidates: int = 800
    test_poses: int = 100
    shell_poses: int = 60
    target_sigma: float = 15e-6

    def jobs(self) -> list[tuple[StudyWorld, int]]:
        """Return all worlds and seeds."""
        return [(world, seed) for seed in self.seeds for world in self.worlds]


@dataclass(frozen=True)
class Record:
    """Errors of one machine after one method.

    Attributes:
        world: which one.
        seed: which machine.
        strategy: how they were chosen; empty for what does not depend on it.
        count: number of poses measured; 0 for what does not depend on it.
        method: see :data:`ROWS`.
        test: see :data:`TESTS`.
        position: mean, 95th percentile and maximum of the tool point's error [m].
        angle: the same of the orientation [rad].
        tip: the same of the tip error [m].
        excess: root mean square of each joint's distance from the best command [m].
        noise: tip error that a measurement's noise amounts to, root mean square [m].
        joint_noise: deviation of each joint that it amounts to, root mean square [m].
        energy: as `tip`, of E = E_xyz + eta E_orientation, (8.15) [m].
    """

    world: str
    seed: int
    strategy: str
    count: int
    method: str
    test: str
    position: tuple[float, float, float]
    angle: tuple[float, float, float]
    tip: tuple[float, float, float]
    excess: float
    noise: float
    joint_noise: float
    energy: tuple[float, float, float]


def run_study(
    plan: StudyPlan,
    directory: Path | str,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """Run a study, or what is left of it: finished worlds and seeds are taken from the folder.

    Args:
        plan: the cases.
        directory: folder for the results of each world and seed. It may hold those of other seeds and worlds, but of
            one study only.
        workers: number of processes.
        progress: called with the number of jobs done and that of all.

    Raises:
        InvalidValueError: the folder holds another study.
        OutputError: a file cannot be written.
    """
    folder, jobs = Path(directory), plan.jobs()
    _claim(folder, plan)
    missing = [job for job in jobs if not _file(folder, *job).is_file()]
    report = progress or (lambda done, total: None)
    report(len(jobs) - len(missing), len(jobs))
    for done, (job, records) in enumerate(_finished(plan, missing, workers), start=1):
        text = json.dumps([asdict(record) for record in records], indent=1) + "\n"
        write_text_atomically(_file(folder, *job), text)
        report(len(jobs) - len(missing) + done, len(jobs))
    return [record for job in jobs for record in _read(_file(folder, *job))]


def run_job(plan: StudyPlan, world: StudyWorld, seed: int) -> list[Record]:
    """Measure, calibrate and evaluate one machine.

    Args:
        plan: the cases.
        world: which one.
        seed: which machine.
    """
    generator = np.random.default_rng([seed, int(world == "geometry")])
    errors = GeometricErrors.load(plan.robot)
    truth = World.random("geometry" if world == "geometry" else "everything", errors, generator)
    instrument = Instrument.with_targets(plan.target_sigma)
    tests = _test_poses(errors, plan, generator)
    first = truth.measure(_training(errors, plan, world, generator), generator, instrument)
    judges = {test: _Judge(truth, poses, instrument, generator) for test, poses in tests.items()}
    records = []
    for test, judge in judges.items():
        records.append(judge.record(world, seed, "", 0, NONE, test, judge.poses.commands))
        records.append(judge.record(world, seed, "", 0, FLOOR, test, judge.best))
    problem = _planning(errors, plan, seed) if set(plan.strategies) != {"random"} else None
    for strategy in plan.strategies:
        for count in plan.counts:
            if strategy == "random":
                measurements = first[:count]
            else:
                assert problem is not None
                chosen = problem.plan(count, strategy, np.random.default_rng(seed), restarts=_RESTARTS)
                measurements = truth.measure(chosen.poses.commands, generator, instrument)
            for method, found in _compensations(measurements, errors, plan.methods, seed).items():
                for test, judge in judges.items():
                    commands = found.corrected(judge.poses, judge.conditions)
                    records.append(judge.record(world, seed, strategy, count, method, test, commands))
    return records


def _compensations(
    measurements: Measurements, errors: GeometricErrors, methods: Sequence[Method], seed: int
) -> dict[Method, Compensation]:
    """Return what :func:`~pm3dof_pin.calibration.calibrate.calibrate` finds by each method; identified once for all."""
    identification = identify(measurements, errors)
    trusted = np.setdiff1d(np.arange(len(measurements)), identification.outliers)
    shown = identification.settled[trusted]
    found = {}
    for method in methods:
        options = Options(method, seed)
        found[method] = compensation_from(shown, errors, options, identification if options.identifies else None)
    return found


def _planning(errors: GeometricErrors, plan: StudyPlan, seed: int) -> PlanningProblem:
    generator = np.random.default_rng([seed, 2])
    candidates, tests = (reachable_poses(errors.robot, count, generator) for count in (plan.candidates, _PLANNED_FOR))
    return PlanningProblem(errors, candidates, tests, instrument=Instrument.with_targets(plan.target_sigma))


class _Judge:
    """Desired poses in a world, and how well commands reach them.

    The machine is put at the best commands, and moved from there along its Jacobian: over the tenths of a millimetre
    by which commands differ, the curvature of its motion amounts to less than a micrometre.
    """

    def __init__(self, truth: World, poses: Poses, instrument: Instrument, generator: np.random.Generator) -> None:
        self.conditions: dict[str, Array | float] = {}
        surroundings = truth.conditions(len(poses), generator)
        self.conditions |= surroundings
        self.poses, self._control = poses, command_jacobians(poses)
        self._before = pose_difference(poses.transforms, truth.poses(poses.commands, surroundings))
        self._left, self.best = self._before, poses.commands
        for _ in range(2):
            self.best = self.best + best_commands(self._control, self._left)
            self._left = pose_difference(poses.transforms, truth.poses(self.best, surroundings))
        sigmas = instrument.sigmas
        self._noise = float(tip_error(sigmas))
        weights = tip_weights()
        spread = np.linalg.pinv(self._control * weights[:, None]) * (weights * sigmas)
        self._joint_noise = float(np.sqrt(np.mean(np.sum(spread**2, axis=2))))

    def record(
        self, world: str, seed: int, strategy: str, count: int, method: str, test: str, commands: Array
    ) -> Record:
        excess = commands - self.best
        reached = self._left + np.einsum("nij,nj->ni", self._control, excess)
        differences = self._before if method == NONE else reached
        return Record(
            world,
            seed,
            strategy,
            count,
            method,
            test,
            _spread(np.linalg.norm(differences[:, :3], axis=1)),
            _spread(np.linalg.norm(differences[:, 3:], axis=1)),
            _spread(tip_error(differences)),
            float(np.sqrt(np.mean(excess**2))),
            self._noise,
            self._joint_noise,
            _spread(weighted_energy(differences * tip_weights())),
        )


def select(records: Iterable[Record], **wanted: Any) -> list[Record]:
    """Return the records with given attributes."""
    return [record for record in records if all(getattr(record, name) == value for name, value in wanted.items())]


def over_seeds(records: Sequence[Record], quantity: str, index: int | None = None) -> tuple[float, float, float]:
    """Return mean, least and greatest of a quantity over the seeds.

    Args:
        records: of one world, count, method and test.
        quantity: name of an attribute.
        index: 0 mean, 1 95th percentile, 2 maximum, for quantities that have them.
    """
    values = [getattr(record, quantity) for record in records]
    numbers = np.array(values if index is None else [value[index] for value in values], dtype=float)
    return float(numbers.mean()), float(numbers.min()), float(numbers.max())


def _spread(values: Array) -> tuple[float, float, float]:
    return float(values.mean()), float(np.percentile(values, 95.0)), float(values.max())


def _test_poses(errors: GeometricErrors, plan: StudyPlan, generator: np.random.Generator) -> dict[str, Poses]:
    robot = errors.robot
    everywhere = reachable_poses(robot, plan.test_poses, generator)
    pool = reachable_poses(robot, _POOL * plan.shell_poses, generator)
    distances = _distances(pool)
    shell = np.flatnonzero(distances >= np.quantile(distances, _SHELL))[: plan.shell_poses]
    return dict(zip(TESTS, (everywhere, pool[shell]), strict=True))


def _training(errors: GeometricErrors, plan: StudyPlan, world: str, generator: np.random.Generator) -> Array:
    count = max(plan.counts)
    if world != "inner half":
        return reachable_poses(errors.robot, count, generator).commands
    pool = reachable_poses(errors.robot, 4 * count, generator)
    distances = _distances(pool)
    return pool.commands[np.flatnonzero(distances <= np.quantile(distances, _INNER))[:count]]


def _distances(poses: Poses) -> Array:
    """Return the distance of poses from the middle of the workspace: root mean square over the motions' ranges."""
    robot = poses.robot
    lower, upper = coordinate_ranges(robot, robot.coordinates)
    middle = 0.5 * (lower + upper)
    return np.asarray(np.sqrt(np.mean(((poses.coordinates - middle) / (upper - lower)) ** 2, axis=1)))


def _claim(folder: Path, plan: StudyPlan) -> None:
    """Record which study the folder is for, or check it."""
    wanted = {name: value for name, value in asdict(plan).items() if name not in ("seeds", "worlds")}
    path = folder / "study.json"
    if not path.is_file():
        write_text_atomically(path, json.dumps(wanted, indent=1) + "\n")
        return
    found = json.loads(path.read_text(encoding="utf-8"))
    if found != json.loads(json.dumps(wanted)):
        raise InvalidValueError("study", wanted, f"{found}, which {folder} holds; or another folder")


def _file(folder: Path, world: str, seed: int) -> Path:
    return folder / f"{world.replace(' ', '_')}_{seed:03d}.json"


def _finished(
    plan: StudyPlan, jobs: Sequence[tuple[StudyWorld, int]], workers: int
) -> Iterator[tuple[tuple[StudyWorld, int], list[Record]]]:
    if workers == 1:
        for job in jobs:
            yield job, run_job(plan, *job)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(run_job, plan, *job): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _read(path: Path) -> list[Record]:
    entries: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    spreads = ("position", "angle", "tip", "energy")
    records = []
    for entry in entries:
        entry |= {name: tuple(entry[name]) for name in spreads}
        records.append(Record(**entry))
    return records
