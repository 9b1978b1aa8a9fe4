"""Errors of identified stiffnesses over their stated standard deviations, on simulated machines.

Each machine has errors of geometry within the tolerances and springs off by a factor whose logarithm has the standard
deviation of the prior, 0.3. 45 poses are measured under wrenches of up to 400 N and 20 N m, with 15 um and 100 urad of
noise. Right sigmas give errors of root mean square 1 in units of sigma, for each spring over the machines.

    python scripts/studies/stiffness_coverage.py [--machines 20] [--robots pm3dof hexapod] [--seed 100]
"""

from __future__ import annotations

import argparse

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.calibration.elastic_term import STIFFNESS_SIGMA
from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.elastic.tool_deflection import stiffened
from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.simulation.simulated_machine import GeometricSource
from pm3dof_pin.simulation.worlds import World
from pm3dof_pin.typing import Vector

POSES = 45
STRONGEST = (400.0, 400.0, 400.0, 20.0, 20.0, 20.0)
NOISE = Instrument(position_sigma=1.5e-5, angle_sigma=1e-4)


def one(robot: str, seed: int) -> tuple[tuple[str, ...], Vector, Vector]:
    """Return the springs, the errors of ln k in sigmas, and the share of the data in each, shape=(springs,)."""
    errors, generator = pm.GeometricErrors.load(robot), np.random.default_rng(seed)
    names = tuple(str(entry["name"]) for entry in errors.robot.springs)
    factors = np.exp(generator.normal(0.0, STIFFNESS_SIGMA, len(names)))
    truth = pm.GeometricErrors(
        stiffened(errors.robot, dict(zip(names, factors.tolist(), strict=True))), errors.parameters
    )
    source = GeometricSource(truth, truth.sample(generator))
    machine = pm.SimulatedMachine(truth.robot, source, elastic=ElasticDeflection(own_weight=False))
    commands = pm.reachable_poses(errors.robot, POSES, generator).commands
    measured = World(machine).loaded(0.0, STRONGEST).measure(commands, generator, NOISE)
    found = fit(measured, errors, Options("lm")).identification
    pairs = zip(factors, (found.stiffness[name] for name in names), strict=True)
    off = np.array([(np.log(k) - np.log(factor)) / sigma for factor, (k, sigma) in pairs])
    return names, off, np.array([found.stiffness_shares[name] for name in names])


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--robots", nargs="+", default=["pm3dof", "hexapod"])
    parser.add_argument("--seed", type=int, default=100)
    options = parser.parse_args()
    for robot in options.robots:
        runs = [one(robot, options.seed + k) for k in range(options.machines)]
        off, shares = (np.array([run[part] for run in runs]) for part in (1, 2))
        print(f"{robot}, {options.machines} machines: errors over sigma, rms {np.sqrt(np.mean(off**2)):.2f}")
        for name, column, share in zip(runs[0][0], off.T, shares.T, strict=True):
            print(
                f"  {name:12s} rms {np.sqrt(np.mean(column**2)):.2f}, share of the data {share.mean():.2f}", flush=True
            )


if __name__ == "__main__":
    main()
