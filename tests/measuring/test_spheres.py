"""Spheres and planes measured from points that lie in a plane, on a line, or nearly so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.datum import Datum
from pm3dof_pin.measuring.instruments.sphere import SPHERE
from pm3dof_pin.measuring.measurement_file import read_measurements

FIVE_BAR = Path(__file__).parents[1] / "machines" / "five_bar"

CENTRE = np.array([0.1, 0.5, 0.12])


@pytest.mark.parametrize(
    "extents", [(0.3, 0.2, 0.0), (0.3, 0.2, 1e-4), (0.3, 0.2, 0.01), (0.3, 0.0, 0.0), (0.3, 0.2, 0.2)]
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_centre_is_off_the_plane(extents: tuple[float, float, float], side: float) -> None:
    """Distances by Pythagoras are met; across a plane or line the direction does not matter."""
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 3)) * extents
    centre = CENTRE * [1.0, 1.0, side]
    distances = np.linalg.norm(points - centre, axis=1)
    found = Datum.fitted(SPHERE, 1, points, distances[:, None])
    np.testing.assert_allclose(found.residuals(points), 0.0, atol=1e-9)
    flat = np.array(extents) == 0.0
    np.testing.assert_allclose(found.origin[~flat], centre[~flat], atol=1e-6)
    assert np.linalg.norm(found.origin[flat]) == pytest.approx(np.linalg.norm(centre[flat]), abs=1e-7)
    if extents[2] == 0.0 < extents[1]:
        assert found.origin[2] > 0.0


@pytest.mark.parametrize("height", [0.0, 0.003, 0.02, 0.1])
def test_centres_near_the_plane_of_a_pen_are_found_with_the_machine(height: float, tmp_path: Path) -> None:
    """Where the height is nearly 0, only its square matters, which noise makes negative as often as not."""
    robot, sigma = Robot.load(FIVE_BAR), 2e-5
    poses = reachable_poses(robot, 25, np.random.default_rng(2))
    errors = closable(GeometricErrors(robot), poses).select(["left_motor.rz", "right_motor.rz"])
    truth, generator = np.array([3e-4, -4e-4]), np.random.default_rng(5)
    reached = errors.apply(truth).forward(poses.commands, guess=poses.q).positions
    centres = np.array([[-0.4, 0.1, height], [0.5, 0.2, -height], [0.1, 0.9, 0.5 * height]])
    rows = [
        [*u, np.linalg.norm(x - centre) + sigma * generator.standard_normal(), k, sigma]
        for u, x in zip(poses.commands.tolist(), reached, strict=True)
        for k, centre in enumerate(np.add(centres, [0.0, 0.0, poses.positions[0, 2]]), start=1)
    ]
    path = tmp_path / "wires.csv"
    header = "u1_rad,u2_rad,distance_m,sphere,sigma_distance_m"
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    found = identify(read_measurements(path, robot), errors, loss="squares")
    assert np.all(np.abs(found.values - truth) < 4.0 * found.sigmas)
    assert found.noise_factor < 1.3
    assert np.nanmax(np.abs(found.normalized_residuals)) < 4.5


@pytest.mark.parametrize("inclination", [0.0, 0.03, 0.2, None])
def test_planes_across_that_of_a_pen_are_found_with_the_machine(inclination: float | None, tmp_path: Path) -> None:
    """Heights above a plane inclined to the upright one are shorter by a cosine; None for one that is touched."""
    robot, sigma, generator = Robot.load(FIVE_BAR), 2e-6, np.random.default_rng(5)
    poses = reachable_poses(robot, 40, np.random.default_rng(2))
    errors = closable(GeometricErrors(robot), poses)
    truth, normal = errors.sample(generator), np.array([0.28, 0.96, 0.0])
    machine = errors.apply(truth).forward(poses.commands, guess=poses.q)
    if inclination is None:
        middle = machine.positions.mean(axis=0)
        goals = middle + np.linspace(-0.05, 0.05, 40)[:, None] * [0.96, -0.28, 0.0]
        machine = machine.robot.reach(goals + sigma * generator.standard_normal((40, 1)) * normal)
    heights = np.cos(inclination or 0.0) * (machine.positions @ normal - 0.3) + sigma * generator.standard_normal(40)
    cells = [machine.commands, np.ones((40, 1)), np.full((40, 1), sigma), heights[:, None]]
    rows = np.hstack(cells)[:, : 4 if inclination is None else 5]
    path = tmp_path / "plane.csv"
    header = "u1_rad,u2_rad,plane,sigma_touch_m" + ("" if inclination is None else ",height_m")
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n")
    found = identify(read_measurements(path, robot), errors)
    off = found.values - truth
    assert off @ np.linalg.solve(found.covariance, off) < chi2.ppf(0.999, len(off))
    squares, left = found.normalized_residuals[:, 0] ** 2, found.expected_squares.sum()
    assert chi2.ppf(0.001, left) < squares.sum() < chi2.ppf(0.999, left)
    leaning = () if inclination is None else ("plane1.ry",)  # which touches do not tell
    assert found.nuisances.names == ("plane1.z", "plane1.rx", *leaning)
