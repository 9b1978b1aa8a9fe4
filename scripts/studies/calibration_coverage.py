"""Coverage of a calibration's stated uncertainty, on machines written without the package.

The machines are those of machines_apart.py. They are measured in the base's frame, from a tracker metres away, by
targets of unknown position, by positions of the tool point and by heights alone, and by every other instrument, beside
the tool point; errors are from half to twice the tolerances of the error files. "encoders" reads the tilts of the
tripod's passive joints beside positions, "level" the tool's. With "heat" the screws are up to 8 K warmer from pose to
pose, known from sensors, for methods that learn. "Richness" is the size of the effects that no parameter describes: 0
for none.

    python scripts/studies/calibration_coverage.py [--machines 40] [--first 0] [--robots tripod] [--linear] [--table]

Seeds from 0 on are for the table of the documentation, those from 1000 on for work on the package. An interrupted study
continues where it stopped: rows in the file are not computed again.
"""

from __future__ import annotations

import argparse
import csv
import logging
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from linear_calibration import Correction, Station, cross_validated, identified
from machines_apart import Arm, FiveBar, Hinged, Machine, Rods, Tripod
from scipy.spatial.transform import Rotation
from small_robots import hexapods

import pm3dof_pin as pm
from pm3dof_pin.calibration.fit import SMOOTH, Options, fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.identification import Identification, identify
from pm3dof_pin.calibration.measurement_plan import SINGULAR
from pm3dof_pin.calibration.refusals import refusals
from pm3dof_pin.calibration.scatter import COVERAGE, Scatter
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.measuring.datum import Datum
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.table import placed_instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.observation import observed, touching_commands, touching_poses
from pm3dof_pin.measuring.registration import register
from pm3dof_pin.simulation.worlds import TEMPERATURE

ETA = 0.1
TARGETS = np.array([[0.12, 0.0, 0.01], [-0.06, 0.1, 0.0], [-0.06, -0.1, -0.02]])
TRACKER = (Rotation.from_rotvec([0.4, -0.7, 1.9]).as_matrix(), np.array([3.0, -1.5, 0.8]))
OTHERS = ("gauge", "wires", "camera", "ballbar", "probe", "line", "socket")
SETUPS = ("base", "tracker", "targets", "positions", "heights", *OTHERS, "level", "encoders", "heat")
TILTS = ("platform_x_joint", "platform_y_joint")
ZEROS = (0.01, -0.02)
"""Errors of the zeros of encoders [rad]."""
WARMEST, EXPANSION = 8.0, 11.5e-6
"""Greatest rise of the screws' temperature [K], and their expansion [1/K]."""
POINT = (0.12, 0.0, 0.01)
ROBOTS = {
    "tripod": "pm3dof",
    "delta": "linear_delta",
    "hexapod": "hexapod",
    "3-RPS": "three_rps",
    "arm": "ur5",
    "6-RUS": None,
    "five-bar": Path(__file__).resolve().parents[2] / "tests" / "machines" / "five_bar" / "five_bar.urdf",
}
"""The robots."""
UNKNOWN = ("arm", "6-RUS", "five-bar")
"""Those without an error file, whose parameters are not compared with the truth."""
TESTS = 60
_DENSE = 80  # noise-free poses from which a machine's parameters are found
_NO_PRIOR = 1e3  # tolerances
_NOT_SAID = (np.nan, np.nan)
_FAR = 4.0  # standard deviations
_STATIONS = 8  # sets of poses for calibrations to first order


@cache
def described(robot: str) -> pm.GeometricErrors:
    """Return the errors of a robot as described, as far as loops can close with them."""
    if robot == "6-RUS":
        with TemporaryDirectory() as folder:
            return closable(pm.GeometricErrors.load(hexapods(Path(folder))[robot]))
    return closable(pm.GeometricErrors.load(ROBOTS[robot], tool_frame="tool0" if robot == "arm" else None))


DRAWN: dict[str, Callable[[np.random.Generator, float, float], Machine]] = {
    "tripod": Tripod.random,
    "delta": Rods.delta,
    "hexapod": Rods.hexapod,
    "3-RPS": Hinged.random,
    "6-RUS": Rods.cranks,
    "five-bar": FiveBar.random,
}
"""Machines that are drawn from dimensions of their own; an arm takes those of its description."""


def drawn(robot: str, generator: np.random.Generator, size: float, richness: float) -> Machine:
    """Draw a machine."""
    if robot in DRAWN:
        return DRAWN[robot](generator, size, richness)
    mechanism = described(robot).robot
    joints = range(1, mechanism.model.njoints)
    placements = [mechanism.model.jointPlacements[j].homogeneous for j in joints]
    placements.append(mechanism.model.frames[mechanism.tool_frame_id].placement.homogeneous)
    axes = ["XYZ".index(mechanism.model.joints[j].shortname()[-1]) for j in joints]
    return Arm.random(generator, size, richness, np.array(placements), np.eye(3)[axes])


@cache
def machine_of(robot: str, seed: int, richness: float) -> tuple[Machine, float]:
    """Return the machine of a seed, and the size of its errors in tolerances; the same geometry for any richness."""
    generator = np.random.default_rng([seed, list(ROBOTS).index(robot)])
    size = float(2.0 ** generator.uniform(-1.0, 1.0))
    return drawn(robot, generator, size, richness), size


def measured(
    machine: Machine, commands: np.ndarray, setup: str, generator: np.random.Generator, nominal: pm.Poses
) -> tuple[Measurements, np.ndarray]:
    """Measure a machine as a user would; also return the true positions of the targets."""
    instrument = None
    if setup in OTHERS:
        instrument = placed_instrument(setup, nominal, point=None if setup == "camera" else POINT)
        nominal = touching_poses(nominal, instrument)
        commands = nominal.commands
    count, normal = len(commands), generator.standard_normal
    sides, times = generator.choice([-1.0, 1.0], commands.shape), np.linspace(-0.5, 0.5, count)
    if instrument is not None:
        return _by(instrument, machine, nominal, sides, times, generator), TARGETS
    rises = generator.uniform(0.0, WARMEST, count) if setup == "heat" else np.zeros(count)
    reached = machine.poses(commands, sides, times, rises)
    positions = reached[:, :3, 3] + 7.5e-6 * normal((count, 3))
    rotations = Rotation.from_rotvec(7.07e-5 * normal((count, 3))).as_matrix() @ reached[:, :3, :3]
    sigmas = np.tile(np.repeat([7.5e-6, 7.07e-5], 3), (count, 1))
    points = np.zeros((count, 3))
    if setup in ("base", "heat"):
        conditions = {TEMPERATURE: rises} if setup == "heat" else {}
        return Measurements(commands, positions, rotations, sigmas, points, conditions=conditions), TARGETS
    if setup == "level":
        return Measurements(commands, positions, rotations, np.where(np.arange(6) < 5, sigmas, np.inf), points), TARGETS
    if setup in ("positions", "encoders"):
        rows = Measurements(commands, positions, None, sigmas[:, :3], points)
        if setup == "encoders":
            assert isinstance(machine, Tripod)
            readings = machine.tilts[:, :2] + ZEROS + 7.07e-5 * normal((count, 2))
            rows = rows.with_encoders(dict.fromkeys(TILTS, "rad"), readings, np.full((count, 2), 7.07e-5))
        return rows, TARGETS
    if setup == "heights":
        only = np.tile([np.inf, np.inf, 7.5e-6], (count, 1))
        return Measurements(commands, positions * [0.0, 0.0, 1.0], None, only, points), TARGETS
    turn, shift = TRACKER
    if setup == "tracker":
        found = register(positions @ turn.T + shift, nominal.positions, turn @ rotations, nominal.rotations)
        seen, turned = found.positions(positions @ turn.T + shift), found.rotations(turn @ rotations)
        return Measurements(commands, seen, turned, sigmas, points, registration=found), TARGETS
    truly = TARGETS + 1e-3 * normal(TARGETS.shape)
    seen = (reached[:, None, :3, 3] + np.einsum("nij,kj->nki", reached[:, :3, :3], truly)).reshape(-1, 3)
    seen = (seen + 15e-6 * normal(seen.shape)) @ turn.T + shift
    at = (nominal.positions[:, None] + np.einsum("nij,kj->nki", nominal.rotations, TARGETS)).reshape(-1, 3)
    found = register(seen, at)
    rows = Measurements(
        np.repeat(commands, 3, axis=0),
        found.positions(seen),
        None,
        np.full((3 * count, 3), 15e-6),
        np.tile(TARGETS, (count, 1)),
        registration=found,
        target_sigma=1e-3,
    )
    return rows, truly


def _by(
    instrument: Instrument,
    machine: Machine,
    nominal: pm.Poses,
    sides: np.ndarray,
    times: np.ndarray,
    generator: np.random.Generator,
) -> Measurements:
    """Measure by an instrument beside the tool; a machine goes on until a probe, line or seat is touched."""

    def reached(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return machine.poses(u, sides, times), nominal.q

    commands = nominal.commands
    if instrument.stops:
        size = (len(commands), instrument.placed[0].kind.dimension)
        early = generator.normal(scale=instrument.position_sigma, size=size)
        commands = touching_commands(nominal.robot, commands, reached, instrument, early)
    given = observed(commands, reached(commands)[0], instrument)
    if instrument.stops:
        given = replace(given, datums=tuple(replace(each, values=0.0 * each.values) for each in given.datums))
    else:
        given = given.with_noise(generator)
    described = nominal.robot.forward(commands, guess=nominal.q)
    at = given.points_on(described[np.repeat(np.arange(len(commands)), len(given) // len(commands))])
    fitted = (Datum.fitted(each.kind, each.number, at, each.numbers) for each in given.datums)
    return replace(given, datums=tuple(fitted))


def tip(wanted: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Return tip-weighted pose errors, shape=(n, 6)."""
    turn = Rotation.from_matrix(reached[:, :3, :3] @ np.swapaxes(wanted[:, :3, :3], 1, 2)).as_rotvec()
    return np.concatenate([reached[:, :3, 3] - wanted[:, :3, 3], ETA * turn], axis=1)


def best_commands(poses: Callable[[np.ndarray], np.ndarray], wanted: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the commands that bring a machine closest to the desired poses."""
    u = start.copy()
    for _ in range(3):
        missed = tip(wanted, poses(u))
        rows = 1e-6 * np.eye(u.shape[1])
        slopes = np.stack([(tip(wanted, poses(u + row)) - missed) / 1e-6 for row in rows], axis=2)
        u = u - np.einsum("nij,nj->ni", np.linalg.pinv(slopes, rcond=1e-3), missed)
    return u


@cache
def true_parameters(robot: str, seed: int) -> np.ndarray:
    """Return the parameters that describe a machine's geometry exactly, by exact poses all over its workspace."""
    errors, machine = described(robot), machine_of(robot, seed, 0.0)[0]
    dense = pm.reachable_poses(errors.robot, _DENSE, np.random.default_rng(7)).commands
    exact = Measurements.from_poses(dense, machine.poses(dense))
    return np.asarray(identify(exact, errors, prior=_NO_PRIOR, loss="squares").values)


def placed(found: Identification, setup: str, truly: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the machine's base and tool as the measurements define them."""
    base, tool = np.eye(4), np.eye(4)
    if setup in ("tracker", "targets"):
        turn, shift = TRACKER
        stands = found.measurements.registration.base  # type: ignore[union-attr]
        base[:3, :3], base[:3, 3] = stands[:3, :3].T @ turn, stands[:3, :3].T @ (shift - stands[:3, 3])
    if setup == "targets":
        believed = TARGETS + found.nuisance_values[found.nuisances.columns("targets")].reshape(-1, 3)
        fitted = register(believed, truly)
        tool[:3, :3], tool[:3, 3] = fitted.rotation, fitted.translation
    return base, tool


Case = tuple[str, int, float, str, str]
"""Robot, machine, richness, setup and method."""


def one(case: Case, count: int) -> dict[str, object]:
    """Calibrate one machine and compare the stated accuracy with the actual one."""
    robot, seed, richness, setup, method = case
    errors = described(robot)
    machine = machine_of(robot, seed, richness)[0]
    generator = np.random.default_rng([seed, SETUPS.index(setup), int(10 * richness)])
    if setup == "heat":
        machine = replace(machine, effects=replace(machine.effects, expansion=EXPANSION))
    poses = drivable(robot, count, generator)
    rows, truly = measured(machine, poses.commands, setup, generator, poses)
    calibration = fit(rows, errors, Options(method))  # type: ignore[arg-type]
    judged = HeldOut.from_cross_validation(calibration)
    calibration = calibration.with_scatter(judged.scatter)
    base, tool = placed(calibration.identification, setup, truly)
    sides = generator.choice([-1.0, 1.0], (TESTS, poses.commands.shape[1]))

    conditions = {TEMPERATURE: generator.uniform(0.0, WARMEST, TESTS)} if setup == "heat" else {}

    def reached(u: np.ndarray) -> np.ndarray:
        return np.asarray(base @ machine.poses(u, sides, 0.0, conditions.get(TEMPERATURE, 0.0)) @ tool)

    tests = drivable(robot, TESTS, generator)
    answer = calibration.compensation.compensate(tests, conditions, on_failure="nan")
    told = np.isfinite(answer.commands).all(axis=1)
    tests, sides = tests[told], sides[told]
    answer = replace(answer, **{field.name: getattr(answer, field.name)[told] for field in fields(answer)})
    conditions = {name: values[told] for name, values in conditions.items()}
    before, after = (tip(tests.transforms, reached(u)) for u in (tests.commands, answer.commands))
    best = best_commands(reached, tests.transforms, answer.commands)
    floor = tip(tests.transforms, reached(best))
    compared = Compared(
        (before, after, floor),
        answer.predicted_error,
        answer.error_bound,
        answer.commands - best,
        judged.excess,
        (calibration.tip_interval(tests) or _NOT_SAID, judged.excess_interval or _NOT_SAID),
    )
    return row(case, calibration.identification, compared, judged.scatter) | {
        "refused": int(bool(refusals(calibration, judged)))
    }


def drivable(robot: str, count: int, generator: np.random.Generator) -> pm.Poses:
    """Draw poses; of the 6-RUS, which has no declared ranges, without those that a plan leaves out as near-singular."""
    errors = described(robot)
    if robot != "6-RUS":
        return pm.reachable_poses(errors.robot, count, generator)
    poses = pm.reachable_poses(errors.robot, 2 * count, generator)
    sizes = np.linalg.norm(error_map(errors, poses).weighted * errors.tolerances, axis=(1, 2))
    return poses[np.flatnonzero(sizes <= SINGULAR * np.median(sizes))[:count]]


@cache
def stations(robot: str, number: int, count: int) -> tuple[Station, Station, Station]:
    """Return poses to measure, others for evaluation, and others over which a correction must do no harm."""
    errors, generator = described(robot), np.random.default_rng([number, count])
    first, second, third = (
        Station(errors, pm.reachable_poses(errors.robot, n, generator)) for n in (count, TESTS, TESTS)
    )
    return first, second, third


def one_linear(case: Case, count: int) -> dict[str, object]:
    """Do the same to first order."""
    robot, seed, richness, setup, _ = case
    machine = machine_of(robot, seed, richness)[0]
    generator = np.random.default_rng([seed, SETUPS.index(setup), int(10 * richness)])
    station, tests, work = stations(robot, seed % _STATIONS, count)
    rows, truly = measured(machine, station.poses.commands, setup, generator, station.poses)
    commands = rows.commands[np.unique(rows.pose_numbers, return_index=True)[1]]
    if not np.array_equal(commands, station.poses.commands):  # where this machine was stopped by a touch
        station = Station(station.errors, station.poses.robot.forward(commands))
    found = identified(station, rows)
    correction = Correction.of(work, found)
    scatter, excess, interval = cross_validated(station, correction)
    base, tool = placed(found, setup, truly)
    sides = generator.choice([-1.0, 1.0], tests.poses.commands.shape)
    before = tip(tests.poses.transforms, base @ machine.poses(tests.poses.commands, sides) @ tool)
    moved, expected, bound, rms = correction.at(tests, scatter)
    after = before + moved
    missing = np.einsum("nij,nj->ni", np.linalg.pinv(tests.control, rcond=1e-3), after)
    floor = after - np.einsum("nij,nj->ni", tests.control, missing)
    intervals = (rms, interval) if found.noise_factor < SMOOTH else (_NOT_SAID, _NOT_SAID)
    compared = Compared((before, after, floor), expected, bound, missing, np.sqrt(np.mean(excess, axis=1)), intervals)
    chance = correction.gain.chance_of_harm(correction.values)
    return row(case, found, compared, scatter) | {"refused": int(chance > 1.0 - COVERAGE)}


@dataclass(frozen=True)
class Compared:
    """The result of a calibration, and its stated accuracy."""

    errors: tuple[np.ndarray, np.ndarray, np.ndarray]  #: tip errors before, after, and with the best commands
    expected: np.ndarray  #: size of that after
    bound: np.ndarray  #: of 95 %
    excess: np.ndarray  #: distance of the commands from the best ones
    excess_said: np.ndarray  #: the same as expected, root mean square over the drives
    #: of the root mean squares over poses, of the size after and of the excess
    intervals: tuple[tuple[float, float], tuple[float, float]]


def row(case: Case, found: Identification, compared: Compared, scatter: Scatter) -> dict[str, object]:
    """Collect the numbers of one calibration."""
    robot, seed, richness, setup, method = case
    sizes = dict(zip(("before", "after", "floor"), (np.linalg.norm(e, axis=1) for e in compared.errors), strict=True))
    off = np.zeros(0)
    if robot not in UNKNOWN:
        off = (found.values - true_parameters(robot, seed)) / found.sigmas

    def micrometres(values: np.ndarray) -> float:
        return round(1e6 * float(np.sqrt(np.mean(values**2))), 3)

    return {
        "robot": robot,
        "machine": seed,
        "size": round(machine_of(robot, seed, richness)[1], 2),
        "richness": richness,
        "setup": setup,
        "method": method,
        "prior": round(found.prior.k, 2),
        "noise_factor": round(found.noise_factor, 3),
        **{f"{name}_um": micrometres(values) for name, values in sizes.items()},
        "expected_um": micrometres(compared.expected),
        "within": float(np.mean(sizes["after"] <= compared.bound)),
        "scatter_um": micrometres(np.array([scatter.tip_error])),
        "excess_true_um": micrometres(compared.excess),
        "excess_said_um": micrometres(compared.excess_said),
        **{
            f"{name}_{end}_um": round(1e6 * value, 3)
            for name, interval in zip(("after", "excess"), compared.intervals, strict=True)
            for end, value in zip(("low", "high"), interval, strict=True)
        },
        "parameters": len(off),
        "beyond_4_sigma": int(np.sum(np.abs(off) > _FAR)),
    }


def table(path: Path) -> str:
    """Return the file's rows as a table, one row for each robot and kind of measurement, errors in micrometres."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    groups: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows:
        key = (row["robot"], row["setup"], "geometry" if float(row["richness"]) == 0.0 else "everything", row["method"])
        groups.setdefault(key, []).append(row)
    heads = (
        *("robot", "measured", "errors", "method", "machines", "before", "after", "floor", "expected", "within"),
        *("refused", "made worse", "of them not refused", "beyond 4 sigma", "commands off", "said to be"),
        *("rms in its interval", "commands in theirs"),
    )
    lines = [heads, ("---",) * len(heads)]
    for key, group in groups.items():

        def column(name: str, group: list[dict[str, str]] = group) -> np.ndarray:
            return np.array([float(row[name]) for row in group])

        def rms(name: str, column: Callable[[str], np.ndarray] = column) -> float:
            return float(np.sqrt(np.mean(column(name) ** 2)))

        beyond, parameters = (int(column(name).sum()) for name in ("beyond_4_sigma", "parameters"))
        held = []
        for true, name in (("after", "after"), ("excess_true", "excess")):
            low, size, high = (column(f"{key}_um") for key in (f"{name}_low", true, f"{name}_high"))
            said = np.isfinite(low)
            held.append(f"{np.sum((low <= size) & (size <= high))} of {np.sum(said)}" if said.any() else "")
        within, refused = column("within"), column("refused") > 0.0
        worse = column("after_um") > column("before_um")
        lines.append(
            (
                *key,
                str(len(group)),
                *(f"{rms(f'{name}_um'):.0f}" for name in ("before", "after", "floor", "expected")),
                f"{100 * within.mean():.1f} ± {100 * within.std(ddof=1) / np.sqrt(len(group)):.1f} %",
                *(str(int(np.sum(flags))) for flags in (refused, worse, worse & ~refused)),
                f"{beyond} of {parameters}" if parameters else "",
                *(f"{rms(f'excess_{name}_um'):.1f}" if key[0] not in UNKNOWN else "" for name in ("true", "said")),
                *held,
            )
        )
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def within_table(path: Path) -> str:
    """Return the poses within their bounds [%] and the number of machines, a row for each kind of measurement."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    robots = [robot for robot in ROBOTS if any(row["robot"] == robot for row in rows)]
    lines = [("measured", *robots), ("---",) * (len(robots) + 1)]
    for setup in SETUPS:
        cells = []
        for robot in robots:
            own = [float(row["within"]) for row in rows if (row["robot"], row["setup"]) == (robot, setup)]
            spread = 100.0 * np.std(own, ddof=1) / np.sqrt(len(own)) if len(own) > 1 else np.nan
            cells.append(f"{100.0 * np.mean(own):.0f} ± {spread:.0f} ({len(own)})" if own else "")
        if any(cells):
            lines.append((setup, *cells))
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def main() -> None:
    """Run the study and write one row for each calibration."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--robots", nargs="*", default=["tripod"], choices=ROBOTS)
    parser.add_argument("--setups", nargs="*", default=SETUPS, choices=SETUPS)
    parser.add_argument("--methods", nargs="*", default=["lm"])
    parser.add_argument("--richness", nargs="*", type=float, default=[0.0, 1.0])
    parser.add_argument("--out", type=Path, default=Path("results/calibration_coverage.csv"))
    parser.add_argument("--linear", action="store_true", help="calibrate to first order, thirty times faster")
    parser.add_argument("--table", action="store_true", help="print the table of the file, and compute nothing")
    parser.add_argument("--within", action="store_true", help="the same for the poses within their bounds alone")
    given = parser.parse_args()
    if given.table or given.within:
        print((table if given.table else within_table)(given.out), end="")
        return
    logging.disable(logging.WARNING)
    run = one_linear if given.linear else one
    given.out.parent.mkdir(parents=True, exist_ok=True)
    keys = ("robot", "machine", "richness", "setup", "method")
    done = set()
    if given.out.is_file():
        with given.out.open(newline="") as file:
            done = {tuple(row[key] for key in keys) for row in csv.DictReader(file)}
    with given.out.open("a", newline="") as file:
        for seed in range(given.first, given.first + given.machines):
            for robot in given.robots:
                for richness in given.richness:
                    # only machines of the tripod's kind have encoders
                    for setup in (each for each in given.setups if each != "encoders" or robot == "tripod"):
                        for method in given.methods:
                            if (robot, str(seed), str(richness), setup, method) in done:
                                continue
                            try:
                                result = run((robot, seed, richness, setup, method), given.poses)
                            except PM3DofError as error:
                                print(robot, seed, richness, setup, method, error)
                                continue
                            writer = csv.DictWriter(file, list(result))
                            if file.tell() == 0:
                                writer.writeheader()
                            writer.writerow(result)
                            file.flush()


if __name__ == "__main__":
    main()
