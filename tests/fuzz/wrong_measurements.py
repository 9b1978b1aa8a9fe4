"""Wrong measurement files: good ones with typical mistakes of users, spreadsheets and instruments, and their results.

Each is a good file with one mistake. A calibration from it is refused with the cause, or goes through with a doubt
that names it, or is as good as with the good file: none is silently wrong.

    python tests/fuzz/wrong_measurements.py [--robots pm3dof hexapod ...] [--only WORD] [--poses 40] [--seed 0]
"""

from __future__ import annotations

import argparse
import logging
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pm3dof_pin.calibration.calibrate import Options, calibrate
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.joint_columns import command_columns
from pm3dof_pin.typing import Array

MACHINES = Path(__file__).parents[1] / "machines"
ROBOTS = {
    "pm3dof": ("pm3dof", None),
    "hexapod": ("hexapod", None),
    "linear_delta": ("linear_delta", None),
    "three_rps": ("three_rps", None),
    "ur5": ("ur5", "tool0"),
    "five_bar": (str(MACHINES / "five_bar"), None),
}
XYZ, QUATERNION = ("x_m", "y_m", "z_m"), ("qw", "qx", "qy", "qz")
POSITION_SIGMA, ANGLE_SIGMA = 1e-5, 5e-5
AS_GOOD = 2.0  # times the error of the calibration from the good file

Table = dict[str, np.ndarray]


@dataclass(frozen=True)
class Result:
    """Tip errors of a machine, root mean square: actual [m], and stated 95 % bound [m]."""

    missed: float
    promise: float


@dataclass(frozen=True)
class Good:
    """A good file of measurements, and its machine."""

    errors: GeometricErrors
    machine: Robot
    table: Table
    other: Table
    wanted: Poses
    zeros: Array | float = 0.0  #: the machine's counter readings with the drives at 0

    @classmethod
    def of(cls, name: str, poses: int, seed: int = 0) -> Good:
        """Measure a machine of a robot; `other` are measurements of another machine of the same kind."""
        robot, frame = ROBOTS[name]
        rng = np.random.default_rng(seed)
        errors = GeometricErrors.load(robot, tool_frame=frame)
        if name == "five_bar":
            errors = closable(errors)
        sample = reachable_poses(errors.robot, poses, rng)
        wanted = reachable_poses(errors.robot, 20, rng)
        machines = [errors.apply(errors.sample(rng)) for _ in range(2)]
        tables = [_table(machine, errors.robot, sample, rng) for machine in machines]
        return cls(errors, machines[0], *tables, wanted)

    @property
    def commands(self) -> tuple[str, ...]:
        """Columns of the commands."""
        return command_columns(self.errors.robot)

    def missed(self, compensation: Compensation | None = None, *, by_targets: bool = False) -> Result:
        """Return the true machine's error when driven by a calibration, or as described, and the stated bound.

        Targets known to a millimetre define the tool: a displacement common to all poses, in its axes, does not count.
        """
        commands, promise = self.wanted.commands, 0.0
        if compensation is not None:
            answer = compensation.compensate(self.wanted, on_failure="nan")
            commands, promise = answer.commands, float(np.sqrt(np.mean(answer.error_bound**2)))
        reached = self.machine.forward(commands - self.zeros, guess=self.wanted.q, on_failure="nan")
        difference = pose_difference(self.wanted.transforms, reached.transforms)
        if by_targets:
            own = np.einsum("nji,nkj->nki", self.wanted.rotations, difference.reshape(-1, 2, 3))
            difference = (own - own.mean(axis=0)).reshape(-1, 6)
        off = tip_error(difference)
        return Result(float(np.sqrt(np.mean(off**2))) if np.isfinite(off).all() else np.inf, promise)


def _table(machine: Robot, robot: Robot, sample: Poses, rng: np.random.Generator) -> Table:
    reached = machine.forward(sample.commands, guess=sample.q)
    count = len(sample)
    turns = Rotation.from_rotvec(rng.normal(0.0, ANGLE_SIGMA, (count, 3))) * Rotation.from_matrix(reached.rotations)
    x, y, z, w = turns.as_quat().T
    table = dict(zip(command_columns(robot), sample.commands.T.copy(), strict=True))
    table |= zip(XYZ, (reached.positions + rng.normal(0.0, POSITION_SIGMA, (count, 3))).T, strict=True)
    table |= zip(QUATERNION, np.where(w < 0.0, -1.0, 1.0) * (w, x, y, z), strict=True)
    for k, name in enumerate(("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")):
        table[f"sigma_{name}"] = np.full(count, POSITION_SIGMA if k < 3 else ANGLE_SIGMA)
    return table


def as_text(table: Table, separator: str = ",") -> str:
    """Return a table as CSV; NaN is an empty cell."""
    rows = np.column_stack(list(table.values()))
    lines = [separator.join("" if number != number else repr(float(number)) for number in row) for row in rows]
    return "\n".join([separator.join(table), *lines]) + "\n"


Spoil = Callable[[Good], Table]
SpoilText = Callable[[Good], Table | str]


@dataclass(frozen=True)
class Wrong:
    """A mistake: its effect on a good file, and the expected message, or none if the result is right."""

    spoil: SpoilText
    says: str = ""
    zero: float = 0.0  #: of the first drive, for which the file may be right and the machine different [m, rad]


def _xyz(table: Table) -> np.ndarray:
    return np.column_stack([table[name] for name in XYZ])


def _turns(table: Table) -> Rotation:
    w, x, y, z = (table[name] for name in QUATERNION)
    return Rotation.from_quat(np.column_stack([x, y, z, w]))


def _seen(table: Table, positions: np.ndarray | None = None, turns: Rotation | None = None) -> Table:
    """Replace positions or orientations."""
    found = dict(table)
    if positions is not None:
        found |= zip(XYZ, positions.T, strict=True)
    if turns is not None:
        x, y, z, w = turns.as_quat().T
        found |= zip(QUATERNION, (w, x, y, z), strict=True)
    return found


def _in_other_units(table: Table) -> Table:
    """Lengths in millimetres and angles in degrees, by the names of their columns."""
    factors = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / np.pi)}
    found = {}
    for name, values in table.items():
        stem, _, unit = name.rpartition("_")
        other, factor = factors.get(unit, (unit, 1.0))
        found[f"{stem}_{other}" if stem else name] = factor * values
    return found


def _commands(change: Callable[[np.ndarray, Good], np.ndarray]) -> Spoil:
    def spoil(good: Good) -> Table:
        commands = np.column_stack([good.table[name] for name in good.commands])
        return {**good.table, **dict(zip(good.commands, change(commands, good).T, strict=True))}

    return spoil


def _negated(chosen: slice) -> Spoil:
    """The counters of some drives are reversed about home."""

    def change(commands: np.ndarray, good: Good) -> np.ndarray:
        found, home = commands.copy(), good.errors.robot.home.commands
        found[:, chosen] = 2.0 * home[chosen] - found[:, chosen]
        return found

    return _commands(change)


def _frame(rotation: Rotation, shift: tuple[float, float, float]) -> Spoil:
    def spoil(good: Good) -> Table:
        return _seen(good.table, rotation.apply(_xyz(good.table)) + shift, rotation * _turns(good.table))

    return spoil


def _axes(axes: np.ndarray, *, turns: bool = True) -> Spoil:
    def spoil(good: Good) -> Table:
        turned = _turns(good.table).as_matrix()
        turned = axes @ turned @ (axes.T if np.linalg.det(axes) < 0.0 else np.eye(3))
        return _seen(good.table, _xyz(good.table) @ axes.T, Rotation.from_matrix(turned) if turns else None)

    return spoil


def _scaled(names: tuple[str, ...] | str, factor: float) -> Spoil:
    def spoil(good: Good) -> Table:
        chosen = good.commands if names == "commands" else names
        return {name: values * factor if name in chosen else values for name, values in good.table.items()}

    return spoil


def _rows(order: Callable[[int], np.ndarray]) -> Spoil:
    return lambda good: {name: values[order(len(values))] for name, values in good.table.items()}


def _with(name: str, values: Callable[[int], np.ndarray]) -> Spoil:
    return lambda good: {**good.table, name: values(len(good.table["x_m"]))}


def _mixed(part: float) -> Spoil:
    """The last rows are from another machine of the same kind."""

    def spoil(good: Good) -> Table:
        first = round((1.0 - part) * len(good.table["x_m"]))
        return {name: np.concatenate([values[:first], good.other[name][first:]]) for name, values in good.table.items()}

    return spoil


def _shifted_tool(x: float, y: float, z: float) -> Spoil:
    return lambda good: _seen(good.table, _xyz(good.table) + _turns(good.table).apply([x, y, z]))


def _stale(part: float) -> Spoil:
    """From some row, the commands are those of the previous row."""

    def change(commands: np.ndarray, good: Good) -> np.ndarray:
        first = round((1.0 - part) * len(commands))
        found = commands.copy()
        found[first:] = commands[first - 1 : -1]
        return found

    return _commands(change)


def _outliers(good: Good) -> Table:
    rng, positions = np.random.default_rng(5), _xyz(good.table)
    chosen = rng.permutation(len(positions))[: len(positions) // 10]
    positions[chosen] += rng.normal(0.0, 2e-3, (len(chosen), 3))
    return _seen(good.table, positions)


def _targets(spoilt: Table, factor: float = 1.0, order: tuple[int, ...] = (0, 1, 2)) -> Table:
    """Three targets instead of a pose, their points in the file in other units or in another order."""
    points = np.array([[0.1, 0.0, 0.02], [-0.04, 0.09, 0.0], [-0.06, -0.07, -0.03]])
    positions, turns = _xyz(spoilt), _turns(spoilt)
    count = len(positions)
    seen = np.stack([positions + turns.apply(point) for point in points], axis=1).reshape(-1, 3)
    table = {name: np.repeat(values, 3) for name, values in spoilt.items() if name.startswith("u")}
    table |= zip(XYZ, seen.T, strict=True)
    table |= zip(("px_m", "py_m", "pz_m"), factor * np.tile(points[list(order)], (count, 1)).T, strict=True)
    return table | {f"sigma_{name}": np.repeat(spoilt[f"sigma_{name}"], 3) for name in XYZ}


def _euler(good: Good) -> Table:
    angles = _turns(good.table).as_euler("xyz")
    return {**good.table, "qw": np.zeros(len(angles)), **dict(zip(QUATERNION[1:], angles.T, strict=True))}


def _nominal(good: Good) -> Table:
    commands = np.column_stack([good.table[name] for name in good.commands])
    robot = good.errors.robot
    poses = robot.forward(commands)
    return _seen(good.table, poses.positions, Rotation.from_matrix(poses.rotations))


MIRROR_Y = np.diag([1.0, -1.0, 1.0])
SWAP_XY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

WRONG: dict[str, Wrong] = {
    # the text
    "millimetres and degrees": Wrong(lambda g: _in_other_units(g.table)),
    "millimetres in the header": Wrong(
        lambda g: as_text(g.table).replace("_m,", "_mm,"), "limits|scale|thousand|all lengths"
    ),
    # the rows
    "one row": Wrong(_rows(lambda n: np.arange(1)), "one pose"),
    "one pose again and again": Wrong(_rows(lambda n: np.zeros(n, dtype=int)), "one pose"),
    "fewer rows than unknowns": Wrong(_rows(lambda n: np.arange(2)), "unknowns"),
    "backwards": Wrong(_rows(lambda n: np.arange(n)[::-1])),
    "all rows twice": Wrong(_rows(lambda n: np.arange(2 * n) % n), "copies of earlier lines"),
    "every tenth an outlier": Wrong(_outliers),
    "half of another machine": Wrong(_mixed(0.5), "times the noise|noise factor"),
    # the drives
    "two drives": Wrong(
        _commands(lambda u, g: u[:, [1, 0, *range(2, u.shape[1])]]), "permuted: u1 holds u2|swapped|mirrored"
    ),
    "cyclic drives": Wrong(_commands(lambda u, g: np.roll(u, 1, axis=1)), "permuted|turned|limits"),
    "one drive the other way": Wrong(_negated(slice(0, 1)), "u1"),
    "all drives the other way": Wrong(
        _negated(slice(None)), "sign|limits|other direction|all drives count|could if all drives"
    ),
    "signs": Wrong(_scaled("commands", -1.0), "limits|sign|other direction|all drives count"),
    "one row below": Wrong(_commands(lambda u, g: np.roll(u, 1, axis=0)), "[13] rows? above"),
    "one row above": Wrong(_commands(lambda u, g: np.roll(u, -1, axis=0)), "[13] rows? below"),
    "seven rows below": Wrong(_commands(lambda u, g: np.roll(u, 7, axis=0)), "7 rows above"),
    "poses backwards": Wrong(_commands(lambda u, g: u[::-1]), "reverse|backwards|order"),
    "poses in another order": Wrong(_commands(lambda u, g: np.random.default_rng(2).permutation(u)), "."),
    "half stale": Wrong(_stale(0.5), "."),
    "one drive constant": Wrong(
        _commands(lambda u, g: np.column_stack([np.full(len(u), u[:, 0].mean()), u[:, 1:]])), "u1"
    ),
    "a drive's zero": Wrong(
        _commands(lambda u, g: u + 0.01 * (np.arange(u.shape[1]) == 0)),
        "zero of u1|u1 .* off|limits|zeros of the drives",
        zero=0.01,
    ),
    "a drive's lead": Wrong(
        _commands(lambda u, g: u * np.where(np.arange(u.shape[1]) == 0, 1.02, 1.0)),
        "u1|times the noise|rows are outliers|tolerances",
    ),
    "relative commands": Wrong(_commands(lambda u, g: u - u[0]), "limits|zero|off|frame|scale"),
    "commands a thousandfold": Wrong(_scaled("commands", 1000.0), "limits"),
    "commands in degrees": Wrong(_scaled("commands", 180.0 / np.pi), "limits"),
    # positions and orientations
    "x and y": Wrong(_axes(SWAP_XY), "mirrored|permuted"),
    "x and y of the positions": Wrong(_axes(SWAP_XY, turns=False), "mirrored|swapped|another frame"),
    "y mirrored": Wrong(_axes(MIRROR_Y), "mirrored|permuted"),
    "x, y turned half": Wrong(_axes(np.diag([-1.0, -1.0, 1.0])), "--own-frame|swapped"),
    "a frame": Wrong(_frame(Rotation.from_rotvec([0.4, -0.7, 1.9]), (3.0, -1.5, 0.8)), "--own-frame"),
    "a frame a little off": Wrong(_frame(Rotation.from_rotvec([0.02, 0.0, 0.0]), (0.002, 0.0, 0.0)), "--own-frame"),
    "a frame shifted": Wrong(_frame(Rotation.identity(), (0.0, 0.0, 0.05)), "--own-frame"),
    "millimetres": Wrong(_scaled(XYZ, 1e3), "millimetres"),
    "inches": Wrong(_scaled(XYZ, 1.0 / 25.4e-3), "inches"),
    "centimetres": Wrong(_scaled(XYZ, 1e2), "centimetres"),
    "x in millimetres": Wrong(_scaled(("x_m",), 1e3), "."),
    "scale of one per cent": Wrong(_scaled(XYZ, 1.01), "."),
    "quaternions x, y, z, w": Wrong(
        lambda g: {**g.table, **dict(zip(QUATERNION, [g.table[n] for n in ("qx", "qy", "qz", "qw")], strict=True))},
        "order x, y, z, w",
    ),
    "quaternions z, y, x, w": Wrong(
        lambda g: {**g.table, **dict(zip(QUATERNION, [g.table[n] for n in QUATERNION[::-1]], strict=True))}, "order"
    ),
    "quaternions w, z, y, x": Wrong(
        lambda g: {**g.table, "qx": g.table["qz"], "qz": g.table["qx"]}, "order|tool's axes"
    ),
    "quaternions conjugate": Wrong(lambda g: _seen(g.table, turns=_turns(g.table).inv()), "inverse"),
    "quaternions negated": Wrong(_scaled(QUATERNION, -1.0)),
    "one sign of the quaternions": Wrong(_scaled(("qx",), -1.0), "."),
    "quaternions of any length": Wrong(_scaled(QUATERNION, 1.5), "not a rotation"),
    "Euler angles": Wrong(_euler, "not a rotation"),
    "another tool": Wrong(
        lambda g: _seen(g.table, turns=_turns(g.table) * Rotation.from_rotvec([0.0, 0.0, np.pi / 2.0])), "tool's axes"
    ),
    "tool point": Wrong(_shifted_tool(0.03, 0.0, 0.0), "point seen"),
    "tool point, a little": Wrong(_shifted_tool(0.003, -0.002, 0.0), "point seen"),
    "pose of the base in the tool": Wrong(
        lambda g: _seen(g.table, -_turns(g.table).inv().apply(_xyz(g.table)), _turns(g.table).inv()),
        "other axes",
    ),
    "x constant": Wrong(lambda g: {**g.table, "x_m": np.full(len(g.table["x_m"]), g.table["x_m"][0])}, "."),
    "z constant": Wrong(lambda g: {**g.table, "z_m": np.full(len(g.table["z_m"]), g.table["z_m"][0])}, "."),
    "rounded to a millimetre": Wrong(
        lambda g: _seen(g.table, np.round(_xyz(g.table), 3)), "times the noise|noise factor|rounded|digits"
    ),
    "the plan instead of measurements": Wrong(_nominal, "description"),
    "targets in millimetres": Wrong(lambda g: _targets(g.table, 1e3), "p[xyz]_m"),
    "targets exchanged": Wrong(lambda g: _targets(g.table, order=(1, 0, 2)), "target"),
    "targets": Wrong(lambda g: _targets(g.table)),
    # noise, time, loads
    "sigmas in millimetres": Wrong(
        _scaled(("sigma_x_m", "sigma_y_m", "sigma_z_m"), 1e3), "positions .* sigmas are in another unit"
    ),
    "sigmas in degrees": Wrong(
        _scaled(("sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad"), 180.0 / np.pi),
        "orientations .* sigmas are in another unit",
    ),
    "sigmas a hundredth": Wrong(
        lambda g: {n: v / 100.0 if n.startswith("sigma") else v for n, v in g.table.items()}, "times the noise"
    ),
    "sigma negative": Wrong(_scaled(("sigma_x_m",), -1.0), "not positive"),
    "sigma zero": Wrong(_scaled(("sigma_x_m",), 0.0), "not positive"),
    "time stands still": Wrong(_with("time_s", np.zeros), "time_s"),
    "time runs backwards": Wrong(_with("time_s", lambda n: -60.0 * np.arange(n))),
    "time missing": Wrong(_with("time_s", lambda n: np.where(np.arange(n) == 4, np.nan, np.arange(n))), "line 6"),
    "approach of no drive": Wrong(_with("aproach_u1", np.ones), "aproach_u1.* not used|no column"),
    "approach of one drive": Wrong(_with("approach_u1", np.ones), "no column approach_u2|time"),
    "approach of any size": Wrong(
        lambda g: {
            **g.table,
            **{f"approach_u{k + 1}": np.full(len(g.table["x_m"]), 0.5) for k in range(len(g.commands))},
        },
        "directions",
    ),
    "an unknown column": Wrong(_with("operator", np.ones), "operator are not used|not used"),
    "a temperature missing": Wrong(
        _with("temperature_air_K", lambda n: np.where(np.arange(n) == 4, np.nan, 293.0)), "line 6"
    ),
}


REFUSED_BY_THE_READER = (
    "millimetres in the header",
    "commands a thousandfold",
    "commands in degrees",
    "millimetres",
    "quaternions x, y, z, w",
    "quaternions conjugate",
    "quaternions of any length",
    "Euler angles",
    "targets in millimetres",
    "sigma negative",
    "sigma zero",
    "approach of one drive",
    "approach of any size",
)


@dataclass(frozen=True)
class Outcome:
    """Result of a file: "refused", "doubted" or "accepted", the messages, and the accuracy of the result."""

    kind: str
    words: str
    result: Result = Result(np.nan, np.nan)


@contextmanager
def _messages() -> Iterator[list[str]]:
    found: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            found.append(record.getMessage())

    handler, logger = Keep(logging.WARNING), logging.getLogger("pm3dof_pin")
    logger.addHandler(handler)
    try:
        yield found
    finally:
        logger.removeHandler(handler)


def outcome(good: Good, spoilt: Table | str, folder: Path, method: str = "lm") -> Outcome:
    """Calibrate from a corrupted file, as the command does."""
    path = folder / "spoilt.csv"
    text = spoilt if isinstance(spoilt, str) else as_text(spoilt)
    path.write_text(text, encoding="utf-8", newline="")
    with _messages() as said:
        try:
            calibration = calibrate(path, good.errors, Options(method))
        except PM3DofError as error:
            return Outcome("refused", " | ".join([*said, str(error)]))
    return Outcome(
        "doubted" if said else "accepted",
        " | ".join(said),
        good.missed(calibration.compensation, by_targets="px_m" in spoilt),
    )


def verdict(wrong: Wrong, found: Outcome, best: float) -> str:
    """Return "" if a file has the expected outcome, otherwise what is wrong.

    It should be refused or doubted with its cause, or be as good as the best [m] or as stated.
    """
    if wrong.says and re.search(wrong.says, found.words):
        return ""
    if found.kind == "refused":
        return "refused without the cause" if wrong.says else "refused though right"
    if found.result.missed <= max(AS_GOOD * best, found.result.promise):
        return ""
    return f"{found.kind}, {1e6 * found.result.missed:.0f} um instead of {1e6 * best:.0f}"


def trials(good: Good, folder: Path, only: str) -> Iterator[tuple[str, str, Outcome]]:
    """Try mistakes in full poses: name, verdict, outcome."""
    best = outcome(good, good.table, folder).result.missed
    for name, wrong in WRONG.items():
        if only in name:
            machine = replace(good, zeros=wrong.zero * np.eye(len(good.commands))[0])
            found = outcome(machine, wrong.spoil(good), folder)
            yield name, verdict(wrong, found, best), found


def main() -> int:
    """Try every mistake on every robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS), choices=list(ROBOTS))
    parser.add_argument("--only", default="", help="mistakes whose name has this")
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    bad = tried = 0
    with tempfile.TemporaryDirectory() as folder:
        for robot in arguments.robots:
            good = Good.of(robot, arguments.poses, arguments.seed)
            for name, problem, found in trials(good, Path(folder), arguments.only):
                tried += 1
                bad += bool(problem)
                if problem or arguments.verbose:
                    print(f"{robot}: {name}: {problem or found.kind}: {found.words[-600:]}", flush=True)
    print(f"{bad} of {tried} files came out wrong")
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
