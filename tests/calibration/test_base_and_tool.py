"""What measurements do not locate: a tool behind targets of unknown places, a base behind an instrument's own frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.expectation import Expectation
from pm3dof_pin.calibration.planning import PlanningProblem
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument, as_points, circle_of_targets
from pm3dof_pin.measuring.instruments.table import placed_instrument
from pm3dof_pin.simulation.worlds import World

TARGET_SIGMA, NOISE = 2e-4, 5e-6


def _expected(kind: str, shift: float) -> tuple[Expectation, float, float]:
    """Calibrate a hexapod whose tool alone is off, seen by targets that are off by a common shift [m].

    Returns:
        What to expect; and how far the tool is off unseen, by the prior and by twice its standard error more [m].
    """
    robot, generator = Robot.load("hexapod"), np.random.default_rng(1)
    own = [each for each in all_parameters(robot) if each.place == robot.tool_frame and each.motion == "translation"]
    errors = GeometricErrors(robot, own)
    world, poses = World.random("geometry", errors, generator), reachable_poses(robot, 30, generator)
    if kind == "camera":
        instrument = placed_instrument("camera", poses, target_sigma=TARGET_SIGMA, sigma=NOISE)
    else:
        instrument = replace(
            Instrument(own_frame=kind == "own frame"),
            targets=circle_of_targets(3),
            target_sigma=TARGET_SIGMA,
            position_sigma=NOISE,
        )
    targets, common = np.array(instrument.targets), shift * np.array([1.0, -1.0, 1.0])
    seen = world.measure(poses.commands, generator, replace(instrument, targets=as_points(targets + common)))
    seen = seen.with_points(seen.points - common)
    found = calibrate(seen, errors, "lm", on_refusal="keep")
    prior = found.identification.prior.k * errors.tolerances[0]
    stretch = 1.0 + 2.0 * found.identification.prior.error
    mean = TARGET_SIGMA / np.sqrt(len(targets))

    def unseen(tool: float) -> float:
        """Of a tool and the mean of targets, of which only the sum is seen, three coordinates each."""
        return float(np.sqrt(3.0 / (1.0 / tool**2 + 1.0 / mean**2)))

    return found.expectation, unseen(prior), unseen(stretch * prior)


@pytest.mark.parametrize("kind", ["base axes", "own frame", "camera"])
def test_a_shift_of_all_targets_with_the_tool_is_told_apart_by_no_instrument(kind: str) -> None:
    """It is left out of the tip error, and stated, alike."""
    found, least, most = _expected(kind, 0.0)
    assert 0.98 * least < found.unlocated["tool"] < 1.02 * most
    assert np.sqrt(sum(value**2 for value in found.budget.values())) < 0.3 * least
    assert "of the tool as its targets show it" in found.text.partition(";")[0]
    assert f"(by the tolerances another {1e6 * found.unlocated['tool']:.0f} µm, rms)" in found.not_seen
    assert ("base" in found.unlocated) == (kind == "own frame")
    shifted, *_ = _expected(kind, 3e-4)
    for name, value in shifted.budget.items():
        assert value == pytest.approx(found.budget[name], rel=0.2, abs=2e-6)


def test_known_targets_locate_the_tool() -> None:
    errors = closable(GeometricErrors.load("hexapod"))
    generator = np.random.default_rng(2)
    world, poses = World.random("geometry", errors, generator), reachable_poses(errors.robot, 40, generator)
    known = replace(Instrument(), targets=circle_of_targets(3), position_sigma=15e-6)
    found = calibrate(world.measure(poses.commands, generator, known), errors, "lm").expectation
    assert not found.unlocated
    assert "as its targets show it" not in found.text


def test_where_a_camera_stands_is_its_frame() -> None:
    """It locates no base, which counts: as the frame, not as the targets, which are known here."""
    errors = closable(GeometricErrors.load("hexapod"))
    generator = np.random.default_rng(2)
    world, poses = World.random("geometry", errors, generator), reachable_poses(errors.robot, 40, generator)
    seen = world.measure(poses.commands, generator, placed_instrument("camera", poses, target_sigma=0.0))
    found = calibrate(seen, errors, "lm", on_refusal="keep").expectation
    assert found.budget["targets"] < 1e-7
    assert found.budget["frame"] > 5e-5
    assert "the location of the base, which counts with its tolerances" in found.not_seen


def test_a_stylus_makes_no_tool_less_certain_than_its_parts() -> None:
    """By heights above a plane nothing tells its place along them, however badly known: the tool is the description's.

    What is expected is then no more than of the machine as described, of parts as far off as the prior says.
    """
    errors = GeometricErrors.load("three_rps")
    generator = np.random.default_rng(3)
    world, poses = World.random("geometry", errors, generator), reachable_poses(errors.robot, 40, generator)
    told = []
    for sigma in (1e-3, 1e-2):
        gauge = placed_instrument("gauge", poses, point=(0.12, 0.0, 0.01), target_sigma=sigma)
        rows = world.measure(poses.commands, np.random.default_rng(4), gauge)
        found = calibrate(rows, errors, "lm", on_refusal="keep")
        told.append(np.sqrt(sum(value**2 for value in found.expectation.budget.values())))
        prior = found.identification.prior
        worst = prior.k * (1.0 + 2.0 * prior.error)
        assert told[-1] < worst * np.sqrt(np.mean(error_map(errors, poses).tip_rms ** 2))
        assert "of the tool as its targets show it" not in found.expectation.text
        problem = PlanningProblem(errors, poses, instrument=gauge)
        assert problem.predicted_tip_rms(range(40)) < problem.predicted_tip_rms(())
    assert told[1] == pytest.approx(told[0], rel=0.1)
