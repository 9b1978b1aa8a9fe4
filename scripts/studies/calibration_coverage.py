"""Is what a calibration says of itself true? Simulated tripods written without the package, calibrated and compared.

The machines here are plain NumPy: sliders on guideways, links, a passive leg, with errors of geometry, lead, guideways,
sag and backlash; nothing of :mod:`pm3dof_pin` moves them. They are measured in the base's frame, from a tracker metres
away, by targets that sit where nobody knows exactly, by positions of the tool point and by heights alone.

    python scripts/studies/calibration_coverage.py [--machines 20] [--poses 40] [--out FILE.csv]
"""

from __future__ import annotations

import argparse
import csv
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.calibration.calibrate import Options, calibrate
from pm3dof_pin.calibration.judging import held_out_errors
from pm3dof_pin.calibration.objections import objections
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.registration import register

ETA = 0.1
TARGETS = np.array([[0.12, 0.0, 0.01], [-0.06, 0.1, 0.0], [-0.06, -0.1, -0.02]])
TRACKER = (Rotation.from_rotvec([0.4, -0.7, 1.9]).as_matrix(), np.array([3.0, -1.5, 0.8]))
SETUPS = ("base", "tracker", "targets", "positions", "heights")


@dataclass
class Tripod:
    """A tripod with errors. All arrays in metres and radians."""

    bases: np.ndarray
    guides: np.ndarray
    sides: np.ndarray
    lengths: np.ndarray
    joints: np.ndarray
    leg_turn: np.ndarray
    leg_shift: np.ndarray
    second_axis: np.ndarray
    tool_turn: np.ndarray
    tool_shift: np.ndarray
    lead: np.ndarray
    waves: np.ndarray
    sag: float

    @classmethod
    def random(cls, generator: np.random.Generator, *, everything: bool) -> Tripod:
        """Draw a machine: 0.1 mm and 0.5 mrad, standard deviations; with everything, effects beyond geometry too."""
        d, a = 1e-4, 5e-4
        normal = generator.standard_normal
        angles = np.radians([-30.0, 90.0, -150.0])
        bases = 0.37425 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) + d * normal((3, 3))
        slope = np.radians(50.0)
        guides = np.stack(
            [-np.cos(slope) * np.cos(angles), -np.cos(slope) * np.sin(angles), np.sin(slope) + 0 * angles], 1
        )
        guides = np.array([Rotation.from_rotvec(a * normal(3)).apply(guide) for guide in guides])
        across = np.array([np.cross(guide, [0.0, 0.0, 1.0]) for guide in guides])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        joints = np.stack([0.075 * np.cos(angles), 0.075 * np.sin(angles), 0.013 + 0 * angles], 1) + d * normal((3, 3))
        rich = float(everything)
        return cls(
            bases=bases + d * normal((3, 1)) * guides,
            guides=guides,
            sides=np.stack([across, np.cross(guides, across)], axis=1),
            lengths=0.353 + d * normal(3),
            joints=joints,
            leg_turn=a * normal(3) * np.array([1.0, 1.0, rich]),
            leg_shift=d * normal(3) * np.array([1.0, 1.0, 0.0]),
            second_axis=a * normal(3) * np.array([0.0, 0.0, 1.0]) + rich * a * normal(3),
            tool_turn=rich * a * normal(3),
            tool_shift=d * normal(3),
            lead=rich * 5e-5 * normal(3),
            waves=np.concatenate(
                [rich * 4e-6 * normal((3, 3, 3)), generator.uniform(0.0, 2 * np.pi, (3, 3, 3))], axis=2
            ),
            sag=rich * 3e-5 * abs(float(normal())),
        )

    def poses(self, commands: np.ndarray, backlash: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the tool's placements, shape=(n, 4, 4)."""
        u = commands * (1.0 + self.lead) + backlash
        periods = np.array([0.12, 0.05, 0.02])
        waves = np.sum(
            self.waves[..., :3] * np.sin(2 * np.pi * u[:, :, None, None] / periods + self.waves[..., 3:]), axis=3
        )
        sliders = self.bases + (u + waves[:, :, 0])[..., None] * self.guides
        sliders += np.einsum("nks,ksj->nkj", waves[:, :, 1:], self.sides)
        x = np.tile([0.0, 0.0, 0.49], (len(u), 1))
        for _ in range(12):
            missed = self._missed(x, sliders)
            step = 1e-6
            slopes = np.stack([(self._missed(x + step * row, sliders) - missed) / step for row in np.eye(3)], axis=2)
            x = x - np.linalg.solve(slopes, missed[..., None])[..., 0]
        return self._tool(x)

    def _platform(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        leg = Rotation.from_rotvec(self.leg_turn)
        place = self.leg_shift + leg.apply(np.stack([0 * x[:, 0], 0 * x[:, 0], x[:, 2] - 0.379], axis=1))
        place[:, 2] += 0.379
        place[:, 2] -= self.sag * (1.0 + 5.0 * (x[:, 2] - 0.49)) + 0.5 * self.sag * np.sum(x[:, :2] ** 2, axis=1)
        first, second = (np.stack([x[:, k] if k == m else 0 * x[:, 0] for m in range(3)], 1) for k in (0, 1))
        turn = leg * Rotation.from_rotvec(first) * Rotation.from_rotvec(self.second_axis) * Rotation.from_rotvec(second)
        return place, turn.as_matrix()

    def _missed(self, x: np.ndarray, sliders: np.ndarray) -> np.ndarray:
        place, turn = self._platform(x)
        ends = place[:, None, :] + np.einsum("nij,kj->nki", turn, self.joints)
        return np.asarray(np.linalg.norm(ends - sliders, axis=2) - self.lengths)

    def _tool(self, x: np.ndarray) -> np.ndarray:
        place, turn = self._platform(x)
        tool = np.tile(np.eye(4), (len(x), 1, 1))
        tool[:, :3, :3] = turn @ Rotation.from_rotvec(self.tool_turn).as_matrix()
        tool[:, :3, 3] = place + turn @ self.tool_shift
        return tool


def measured(
    machine: Tripod, commands: np.ndarray, setup: str, generator: np.random.Generator, truth: dict[str, np.ndarray]
) -> Measurements:
    """Measure a machine as a person would; what only the machine knows is added to `truth`."""
    reached, count, normal = machine.poses(commands), len(commands), generator.standard_normal
    positions = reached[:, :3, 3] + 7.5e-6 * normal((count, 3))
    rotations = Rotation.from_rotvec(7.07e-5 * normal((count, 3))).as_matrix() @ reached[:, :3, :3]
    sigmas = np.tile(np.repeat([7.5e-6, 7.07e-5], 3), (count, 1))
    points = np.zeros((count, 3))
    if setup == "base":
        return Measurements(commands, positions, rotations, sigmas, points)
    if setup == "positions":
        return Measurements(commands, positions, None, sigmas[:, :3], points)
    if setup == "heights":
        only = np.tile([10.0, 10.0, 7.5e-6], (count, 1))
        return Measurements(commands, positions * [0.0, 0.0, 1.0], None, only, points)
    turn, shift = TRACKER
    nominal = pm.load("pm3dof").forward(commands)
    if setup == "tracker":
        found = register(positions @ turn.T + shift, nominal.positions, turn @ rotations, nominal.rotations)
        seen, turned = found.positions(positions @ turn.T + shift), found.rotations(turn @ rotations)
        return Measurements(commands, seen, turned, sigmas, points, registration=found)
    truth["targets"] = truly = TARGETS + 1e-3 * normal(TARGETS.shape)
    seen = (reached[:, None, :3, 3] + np.einsum("nij,kj->nki", reached[:, :3, :3], truly)).reshape(-1, 3)
    seen = (seen + 15e-6 * normal(seen.shape)) @ turn.T + shift
    at = (nominal.positions[:, None] + np.einsum("nij,kj->nki", nominal.rotations, TARGETS)).reshape(-1, 3)
    found = register(seen, at)
    return Measurements(
        np.repeat(commands, 3, axis=0),
        found.positions(seen),
        None,
        np.full((3 * count, 3), 15e-6),
        np.tile(TARGETS, (count, 1)),
        registration=found,
        target_sigma=1e-3,
    )


def tip(wanted: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Return tip-weighted pose errors, shape=(n, 6)."""
    turn = Rotation.from_matrix(reached[:, :3, :3] @ np.swapaxes(wanted[:, :3, :3], 1, 2)).as_rotvec()
    return np.concatenate([reached[:, :3, 3] - wanted[:, :3, 3], ETA * turn], axis=1)


def best_commands(poses: Callable[[np.ndarray], np.ndarray], wanted: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the commands that bring a machine nearest."""
    u = start.copy()
    for _ in range(4):
        missed = tip(wanted, poses(u))
        slopes = np.stack([(tip(wanted, poses(u + 1e-6 * row)) - missed) / 1e-6 for row in np.eye(3)], axis=2)
        u = u - np.einsum("nij,nj->ni", np.linalg.pinv(slopes), missed)
    return u


def main() -> None:
    """Run the study and write one row for each calibration."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--setups", nargs="*", default=SETUPS)
    parser.add_argument("--methods", nargs="*", default=["lm", "lm+gp"])
    parser.add_argument("--out", type=Path, default=Path("results/calibration_coverage.csv"))
    given = parser.parse_args()
    logging.disable(logging.WARNING)
    errors = pm.GeometricErrors.load("pm3dof")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    with given.out.open("w", newline="") as file:
        writer = None
        for seed in range(given.first, given.first + given.machines):
            for everything in (False, True):
                for setup in given.setups:
                    for method in given.methods:
                        row = one(errors, seed, everything, setup, method, given.poses)
                        writer = writer or csv.DictWriter(file, list(row))
                        if file.tell() == 0:
                            writer.writeheader()
                        writer.writerow(row)
                        file.flush()


def one(
    errors: pm.GeometricErrors, seed: int, everything: bool, setup: str, method: str, count: int
) -> dict[str, object]:
    """Calibrate one machine and compare what is said of it with what is."""
    generator = np.random.default_rng([seed, everything, SETUPS.index(setup)])
    machine = Tripod.random(np.random.default_rng([seed, everything]), everything=everything)
    commands = pm.reachable_poses(errors.robot, count, generator).commands
    truth: dict[str, np.ndarray] = {}
    calibration = calibrate(measured(machine, commands, setup, generator, truth), errors, Options(method))  # type: ignore[arg-type]
    judged = held_out_errors(calibration)
    calibration = calibration.with_scatter(judged.scatter)
    found = calibration.identification
    base, tool = np.eye(4), np.eye(4)
    if setup in ("tracker", "targets"):  # base and tool are what the measurements say they are
        turn, shift = TRACKER
        placed = found.measurements.registration.base  # type: ignore[union-attr]
        base[:3, :3], base[:3, 3] = placed[:3, :3].T @ turn, placed[:3, :3].T @ (shift - placed[:3, 3])
    if setup == "targets":
        believed = TARGETS + found.nuisance_values[found.nuisances.columns("targets")].reshape(-1, 3)
        fitted = register(believed, truth["targets"])
        tool[:3, :3], tool[:3, 3] = fitted.rotation, fitted.translation

    def poses(u: np.ndarray) -> np.ndarray:
        return np.asarray(base @ machine.poses(u) @ tool)

    tests = pm.reachable_poses(errors.robot, 60, np.random.default_rng([seed, 99]))
    answer = calibration.compensation.compensate(tests)
    before, after = (tip(tests.transforms, poses(u)) for u in (tests.commands, answer.commands))
    best = best_commands(poses, tests.transforms, answer.commands)
    floor = tip(tests.transforms, poses(best))
    sizes = {name: np.linalg.norm(e, axis=1) for name, e in (("before", before), ("after", after), ("floor", floor))}
    return {
        "machine": seed,
        "everything": int(everything),
        "setup": setup,
        "method": method,
        "refused": int(bool(objections(calibration, judged))),
        "rank": found.identifiability.rank,
        "prior": round(found.prior, 2),
        "noise_factor": round(found.noise_factor, 3),
        **{f"{name}_um": round(1e6 * float(np.sqrt(np.mean(e**2))), 2) for name, e in sizes.items()},
        "expected_um": round(1e6 * float(np.sqrt(np.mean(answer.predicted_error**2))), 2),
        "within": float(np.mean(sizes["after"] <= answer.error_bound)),
        "excess_true_um": round(1e6 * float(np.sqrt(np.mean((answer.commands - best) ** 2))), 3),
        "excess_said_um": round(1e6 * float(np.sqrt(np.mean(judged.excess**2))), 3),
        "within_held_out": judged.within,
    }


if __name__ == "__main__":
    main()
