"""Measurements under known wrenches: stiffness identified with the geometry, and commands that correct for loads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.calibration.elastic_term import ElasticTerm
from pm3dof_pin.calibration.fit import Fit, Options, fit
from pm3dof_pin.calibration.planning import PlanningProblem
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.tool_deflection import spring_deflections, stiffened
from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.wrenches import WRENCH_COLUMNS
from pm3dof_pin.simulation.simulated_machine import Conditions, GeometricSource, SimulatedMachine
from pm3dof_pin.simulation.worlds import World

STRONGEST = (400.0, 400.0, 400.0, 20.0, 20.0, 20.0)


@pytest.fixture(scope="module", params=["pm3dof", "hexapod"])
def loaded(request: pytest.FixtureRequest) -> tuple[World, dict[str, float], Fit]:
    """A machine with springs different from the description, and its calibration from measurements under wrenches."""
    errors, generator = GeometricErrors.load(request.param), np.random.default_rng(3)
    names = [str(entry["name"]) for entry in errors.robot.springs]
    factors = dict(zip(names, np.exp(generator.normal(0.0, 0.25, len(names))).tolist(), strict=True))
    truth = GeometricErrors(stiffened(errors.robot, factors), errors.parameters)
    source = GeometricSource(truth, truth.sample(generator))
    machine = SimulatedMachine(truth.robot, source, elastic=ElasticDeflection(own_weight=False))
    world = World(machine).loaded(0.0, STRONGEST)
    commands = reachable_poses(errors.robot, 45, generator).commands
    measured = world.measure(commands, generator, Instrument(position_sigma=2e-6, angle_sigma=1e-5))
    return world, factors, fit(measured, errors, Options("lm"))


@pytest.mark.parametrize("name", ["pm3dof", "hexapod"])
def test_derivatives_by_stiffness_and_the_loaded_equilibrium(name: str) -> None:
    """Central differences; and for a small wrench, in the linear range, Newton's equilibrium of the elastic model."""
    robot, generator = Robot.load(name), np.random.default_rng(0)
    poses = reachable_poses(robot, 3, generator)
    wrenches = generator.normal(size=(3, 6)) * [1.0, 1.0, 1.0, 0.1, 0.1, 0.1]
    term = ElasticTerm(tuple(str(entry["name"]) for entry in robot.springs), wrenches)
    at, step = generator.normal(0.0, 0.3, len(term.springs)), 1e-5
    derivatives = term.derivatives(poses, at)
    for k, unit in enumerate(np.eye(len(at))):
        ends = [-term.derivatives(poses, at + sign * step * unit).sum(axis=2) for sign in (1.0, -1.0)]
        expected = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(derivatives[:, :, k], expected, atol=1e-7 * np.abs(derivatives).max())
    model = ElasticModel(stiffened(robot, dict(zip(term.springs, np.exp(at).tolist(), strict=True))))
    for row, q in enumerate(poses.q):
        loads = Loads(wrenches={str(robot.tool_frame): wrenches[row]})
        expected = loaded_equilibrium(model, q, loads).displacement()
        np.testing.assert_allclose(-derivatives[row].sum(axis=1), expected, atol=1e-4 * np.abs(expected).max())


def test_springs_and_geometry_are_found_within_their_uncertainty(
    loaded: tuple[World, dict[str, float], Fit],
) -> None:
    world, factors, calibration = loaded
    found = calibration.identification
    assert world.machine.geometric is not None
    assert np.all(np.abs(found.values - world.machine.geometric.values) < 4.0 * found.sigmas)
    assert set(found.stiffness) == set(factors)
    errors = [(np.log(factor) - np.log(factors[name])) / sigma for name, (factor, sigma) in found.stiffness.items()]
    assert np.abs(errors).max() < 4.0
    assert found.noise_factor < 1.3  # its square has a standard error of 0.17, by medians over 45 rows
    assert found.identifiability.names[-len(factors) :] == tuple(f"{name}.ln_k" for name in factors)
    assert min(sigma for _, sigma in found.stiffness.values()) < 0.025  # the softest are known far better than before


def test_what_the_prior_holds_is_not_called_determined() -> None:
    """Actuators at 0.75 of the description, loads too small to see it: they come back as described, and it is said."""
    errors, generator = GeometricErrors.load("pm3dof"), np.random.default_rng(1)
    drives = [f"actuator{k}" for k in (1, 2, 3)]
    truth = GeometricErrors(stiffened(errors.robot, dict.fromkeys(drives, 0.75)), errors.parameters)
    world = World(SimulatedMachine(truth.robot, elastic=ElasticDeflection(own_weight=False))).loaded(0.0, STRONGEST)
    commands = reachable_poses(errors.robot, 45, generator).commands
    measured = world.measure(commands, generator, Instrument(position_sigma=3e-5, angle_sigma=1.5e-4))
    found = fit(measured, errors, Options("lm")).identification
    leg, others = found.stiffness_shares.pop("passive_leg"), found.stiffness_shares
    assert leg > 0.99
    assert "passive_leg.ln_k" not in found.prior_dominated
    for drive in drives:
        assert others[drive] < 0.2
        assert f"{drive}.ln_k" in found.prior_dominated
        assert abs(np.log(found.stiffness[drive][0] / 0.75)) < 3.0 * found.stiffness[drive][1]


def test_commands_allow_for_a_wrench(loaded: tuple[World, dict[str, float], Fit]) -> None:
    """The true machine is commanded under 500 N sideways."""
    world, _, calibration = loaded
    compensation = calibration.compensation
    wanted = reachable_poses(compensation.errors.robot, 10, np.random.default_rng(5))
    conditions = {"load_fx_N": 500.0}
    answer = compensation.compensate(wanted, conditions)

    def tip(commands: np.ndarray) -> float:
        reached = world.machine.poses(commands, Conditions(wrenches=[500.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        return float(tip_error(pose_difference(wanted.transforms, reached)).mean())

    assert tip(answer.commands) < 0.9 * tip(compensation.compensate(wanted).commands)
    assert abs(answer.predicted_error.mean() - tip(answer.commands)) < 0.1 * tip(answer.commands) + 2e-6
    predicted = compensation.poses(wanted, conditions).transforms
    reached = world.machine.poses(wanted.commands, Conditions(wrenches=[500.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert tip_error(pose_difference(reached, predicted)).max() < 3e-5


def test_a_plan_says_how_well_stiffness_will_be_known(
    loaded: tuple[World, dict[str, float], Fit],
) -> None:
    """Predicted for the described robot, and found at the planned poses and wrenches of a different machine."""
    world, factors, calibration = loaded
    errors, generator = calibration.identification.errors, np.random.default_rng(7)
    candidates, tests = (reachable_poses(errors.robot, count, generator) for count in (120, 30))
    wrenches = generator.uniform(-1.0, 1.0, (120, 6)) * STRONGEST
    instrument = Instrument(position_sigma=2e-6, angle_sigma=1e-5)
    problem = PlanningProblem(errors, candidates, tests, instrument=instrument, wrenches=wrenches)
    unloaded = PlanningProblem(errors, candidates, tests, instrument=instrument)
    assert problem.predicted_tip_rms([]) > unloaded.predicted_tip_rms([])
    plan = problem.plan(25, "random", generator)
    assert plan.identifiability.names == problem.unknowns
    given = dict(zip(WRENCH_COLUMNS, wrenches[plan.indices].T, strict=True))
    measured = world.measure(plan.poses.commands, generator, instrument, given)
    found = fit(measured, errors, Options("lm")).identification
    predicted = problem.predicted_sigmas(plan.indices)
    for name, (_, sigma) in found.stiffness.items():
        # a stiffer spring shows less, in proportion
        expected = min(0.3, predicted[f"{name}.ln_k"] * max(1.0, factors[name])) * found.noise_factor
        assert 0.4 * expected < sigma < 2.0 * expected + 1e-3


def test_what_is_left_without_deflections(tripod_nominal: Poses) -> None:
    """Targets off the tool point, on a tool displaced by a rotation and a shift, return to their places."""
    poses, generator = tripod_nominal[:4], np.random.default_rng(2)
    points = generator.normal(0.0, 0.1, (4, 3))
    unloaded = poses.positions + np.einsum("nij,nj->ni", poses.rotations, points)
    displacements = generator.normal(0.0, 1e-2, (4, 6))
    angles = np.linalg.norm(displacements[:, 3:], axis=1)[:, None, None]
    cross = np.array([np.cross(np.eye(3), v) for v in displacements[:, 3:]])
    turns = np.eye(3) + np.sin(angles) / angles * cross + (1.0 - np.cos(angles)) / angles**2 * cross @ cross
    seen = poses.positions + displacements[:, :3] + np.einsum("nij,nj->ni", turns @ poses.rotations, points)
    conditions = {WRENCH_COLUMNS[0]: np.ones(4), "temperature_K": np.ones(4)}
    measured = Measurements(poses.commands, seen, turns @ poses.rotations, np.ones((4, 6)), points, conditions)
    back = measured.without_motions(poses, displacements)
    np.testing.assert_allclose(back.positions, unloaded, atol=1e-12)
    np.testing.assert_allclose(back.rotations, poses.rotations, atol=1e-12)


def test_springs_that_are_not_there(tripod_nominal: Poses) -> None:
    robot = tripod_nominal.robot
    with pytest.raises(InvalidValueError, match="actuator1"):
        stiffened(robot, {"actuator9": 2.0})
    with pytest.raises(InvalidValueError, match="positive"):
        stiffened(robot, {"actuator1": 0.0})
    with pytest.raises(InvalidValueError, match="wrenches"):
        spring_deflections(tripod_nominal[:2], np.ones((1, 6)))


@pytest.mark.usefixtures("report_without_pictures", "few_folds")
def test_the_commands(answer: Callable[..., dict[str, Any]], run: Callable[..., Any], tmp_path: Path) -> None:
    loads = [str(number) for number in STRONGEST]
    plan = ("calibration-plan", "--poses", "16", "--candidates", "60", "--strategy", "random", "--out", "plan.csv")
    planned = answer(*plan, "--wrench", *loads, cwd=tmp_path)
    assert planned["predicted_stiffness_sigma_of_logarithm"]["passive_leg"] < 0.1
    answer("measure", "--plan", "plan.csv", "--out", "m.csv", cwd=tmp_path)
    refused = run("measure", "--plan", "plan.csv", "--world", "geometry", "--out", "no.csv", cwd=tmp_path)
    assert refused.returncode == 1
    assert "no springs" in refused.stderr
    among = ("calibration-plan", "--poses", "5", "--among", "plan.csv", "--strategy", "random", "--out", "few.csv")
    few = answer(*among, cwd=tmp_path)
    assert {tuple(row) for row in few["commands_m"]} <= {tuple(row) for row in planned["commands_m"]}
    summary = answer("calibrate", "m.csv", "--method", "lm", "--out", "c", cwd=tmp_path)
    stiffness = summary["identification"]["stiffness"]["passive_leg"]
    assert stiffness["sigma_of_logarithm"] < 0.1
    described, written = (Robot.load(robot).springs[-1] for robot in ("pm3dof", tmp_path / "c/calibrated/pm3dof.urdf"))
    for key in ("bending_stiffness", "torsional_stiffness"):
        assert written[key] / described[key] == pytest.approx(stiffness["factor"])
    assert written["length"] == described["length"]
    pose = ("compensate", "0", "0", "0.49", "--calibration", "c")
    plain = answer(*pose, cwd=tmp_path)
    pressed = answer(*pose, "--wrench", "0", "0", "-500", "0", "0", "0", cwd=tmp_path)
    assert pressed["conditions"]["load_fz_N"] == -500.0
    # pushed down by 500 N at 2.6e8 N/m felt, the commands go up by about 2 um over 0.95, the drives' share of a rise
    assert 1e-6 < min(np.subtract(pressed["u_m"], plain["u_m"])) < 3e-6


def test_one_number_a_spring_is_what_measurements_tell() -> None:
    """Diagonal entries of two beams of the 3-RPS machine one by one, by finite differences: half equal others."""
    robot, generator = Robot.load("three_rps"), np.random.default_rng(1)
    poses = reachable_poses(robot, 5, np.random.default_rng(0))
    wrenches = generator.uniform(-1.0, 1.0, (5, 6)) * [100.0, 100.0, 100.0, 20.0, 20.0, 20.0]

    def deflections(springs: list[dict[str, Any]]) -> np.ndarray:
        changed = robot.replace(springs=springs)
        matrices = compliance(changed, Poses(changed, poses.q), engine="pinocchio")
        return np.einsum("nij,nj->ni", matrices, wrenches) / [2e-6, 2e-6, 2e-6, 1e-5, 1e-5, 1e-5]

    def changed(place: int, entry: int, by: float) -> list[dict[str, Any]]:
        springs = [dict(spring) for spring in robot.springs]
        factors = np.ones(6)
        factors[entry] = np.exp(0.5 * by)
        springs[place]["matrix"] = (np.array(springs[place]["matrix"]) * factors * factors[:, None]).tolist()
        return springs

    step = 1e-4
    beams = [place for place, spring in enumerate(robot.springs) if "matrix" in spring][:2]
    entries = [
        (deflections(changed(place, entry, step)) - deflections(changed(place, entry, -step))).ravel() / (2.0 * step)
        for place in beams
        for entry in range(6)
    ]
    by_spring = ElasticTerm(tuple(str(spring["name"]) for spring in robot.springs), wrenches)
    whole = by_spring.derivatives(poses, np.zeros(len(robot.springs))) / np.array([2e-6] * 3 + [1e-5] * 3)[:, None]
    singular = [np.linalg.svd(matrix, compute_uv=False) for matrix in (np.transpose(entries), whole.reshape(30, -1))]
    ranks = [int(np.sum(values > 1e-8 * values[0])) for values in singular]
    assert ranks[1] == len(robot.springs)
    assert ranks[0] <= len(entries) / 2
