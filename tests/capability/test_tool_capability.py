"""Forces and speeds of the tool against linear programs, finite differences and sums that can be done by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog

import pm3dof_pin as pm
from pm3dof_pin.capability.tool_capability import ToolCapability
from pm3dof_pin.dynamics.batch import actuator_forces
from pm3dof_pin.exceptions import InvalidValueError

_MACHINES = Path(__file__).parents[1] / "machines"


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "five_bar", "four_rrr", "linear_delta"])
def test_pushes_against_linear_programs(name: str) -> None:
    """The greatest s for which some forces of the drives balance the weight and s times a wrench: principle of work."""
    robot = pm.load(_MACHINES / name if (_MACHINES / name).exists() else name)
    generator = np.random.default_rng(2)
    poses = pm.reachable_poses(robot, 4, generator)
    effort, speed = generator.uniform(50.0, 90.0, (2, len(robot.actuated_joints)))
    at = pm.tool_capability(robot, poses, effort=effort, speed=speed)
    n = at.tool_rates.shape[-1]
    for k, direction in enumerate(generator.normal(size=(4, 6))):
        A, T, h = at.drive_rates[k], at.tool_rates[k], at.weight[k]
        system = np.hstack([A.T, -(T.T @ direction)[:, None]])
        ends = [*((-e, e) for e in effort), (0.0, None)]
        found = linprog([0.0] * len(effort) + [-1.0], A_eq=system, b_eq=h, bounds=ends)
        np.testing.assert_allclose(at.greatest_wrench(direction)[k], found.x[-1], rtol=1e-8)
        left = at.effort_left(found.x[-1] * direction)[k]
        assert abs(left) < 1e-8
        rates = generator.normal(size=n)
        fastest = min(speed / np.abs(A @ rates))
        np.testing.assert_allclose(at.greatest_twist(T @ rates)[k], fastest, rtol=1e-8)
        assert n == 6 or at.greatest_twist(generator.normal(size=6))[k] == 0.0


@pytest.mark.parametrize("name", ["hexapod", "four_rrr", "linear_delta"])
def test_ellipsoids_against_least_norms(name: str) -> None:
    """Forces by the least norm of the drives' relative efforts, speeds by singular values after a QR factorization."""
    robot = pm.load(_MACHINES / name if (_MACHINES / name).exists() else name)
    generator = np.random.default_rng(5)
    effort, speed = generator.uniform(50.0, 90.0, (2, len(robot.actuated_joints)))
    at = pm.tool_capability(robot, pm.reachable_poses(robot, 3, generator), effort=effort, speed=speed)
    (forces, axes), (speeds, _) = at.force_ellipsoid(), at.speed_ellipsoid()
    for k in range(3):
        A, T = at.drive_rates[k], at.tool_rates[k]
        for size, axis in zip(forces[k], axes[k].T, strict=True):
            if np.isfinite(size):
                least = np.linalg.lstsq(A.T * effort, T[:3].T @ axis)[0]
                assert size * np.linalg.norm(least) == pytest.approx(1.0, rel=1e-9)
        upper = np.linalg.qr(A / speed[:, None])[1]
        values = np.linalg.svd(T[:3] @ np.linalg.inv(upper), compute_uv=False)
        np.testing.assert_allclose(speeds[k][: len(values)], values, atol=1e-9)


def test_linear_programs_give_what_polytopes_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of drives with too many facets each direction is a linear program; infinite and NaN where polytopes are."""
    robot = pm.load(_MACHINES / "four_rrr")
    poses = pm.reachable_poses(robot, 3, np.random.default_rng(2))
    at = pm.tool_capability(robot, poses, effort=60.0)
    weak = pm.tool_capability(robot, poses, effort=0.0)
    directions = [*np.eye(6), -np.eye(6)[0], *np.random.default_rng(1).normal(size=(2, 6))]
    expected = [[own.greatest_wrench(direction) for direction in directions] for own in (at, weak)]
    left = [at.effort_left(100.0 * np.array(directions)), at.effort_left(directions[-1])]
    monkeypatch.setattr("pm3dof_pin.capability.tool_capability.MOST_FACETS", 0)
    found = [[own.greatest_wrench(direction) for direction in directions] for own in (at, weak)]
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    assert np.isinf(found[0]).any()
    np.testing.assert_allclose(
        [at.effort_left(100.0 * np.array(directions)), at.effort_left(directions[-1])], left, atol=1e-8
    )
    assert (left[0] < 0.0).all()
    assert (left[1] > 0.0).all()


def test_linear_programs_count_the_weight_on_its_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up and down, as the polytopes have it: drives that hold the weight push down by more than up."""
    robot = pm.load("hexapod")
    at = pm.tool_capability(robot, robot.home, effort=300.0, payloads={robot.frame_name(): 20.0})
    ends = [np.array([0.0, 0.0, sign, 0.0, 0.0, 0.0]) for sign in (1.0, -1.0)]
    up, down = (float(at.greatest_wrench(end)) for end in ends)
    assert down > 1.1 * up
    monkeypatch.setattr("pm3dof_pin.capability.tool_capability.MOST_FACETS", 0)
    np.testing.assert_allclose([float(at.greatest_wrench(end)) for end in ends], [up, down], rtol=1e-8)


def test_the_share_left_is_that_of_the_most_loaded_drive() -> None:
    robot = pm.load("hexapod")
    poses = pm.reachable_poses(robot, 6, np.random.default_rng(0))
    at = pm.tool_capability(robot, poses, effort=300.0)
    wrench = np.array([40.0, -30.0, 200.0, 1.0, 2.0, -3.0])
    drives = pm.jacobian(robot, poses, of="tool", by="commands").values
    held = actuator_forces(robot, poses) + np.einsum("ntu,t->nu", drives, wrench)
    np.testing.assert_allclose(at.effort_left(wrench), 1.0 - np.abs(held).max(axis=1) / 300.0, atol=1e-9)
    np.testing.assert_allclose(
        at.effort_left([wrench, -wrench]), np.minimum(at.effort_left(wrench), at.effort_left(-wrench))
    )


def test_a_vertical_push_of_the_level_tripod() -> None:
    """Virtual work: the drives' forces times their travel per height is the push plus the weight."""
    robot = pm.load("pm3dof")
    rate = pm.jacobian(robot, robot.home, of="commands", by=["theta_x", "theta_y", "z_e"]).values[:, 2]
    weight = sum(body.mass for body in list(robot.model.inertias)[1:]) * 9.81
    at = pm.tool_capability(robot, robot.home, effort=500.0)
    up, down = (float(at.greatest_wrench([0, 0, sign, 0, 0, 0])) for sign in (1.0, -1.0))
    np.testing.assert_allclose(up + down, 2.0 * 500.0 * rate.sum(), rtol=1e-9)
    assert 0.0 < down - up < 2.0 * weight
    assert np.isinf(at.greatest_wrench([1, 0, 0, 0, 0, 0]))  # the passive leg carries it


def test_a_payload_beyond_the_drives_leaves_nothing() -> None:
    robot = pm.load("pm3dof")
    at = pm.tool_capability(robot, robot.home, effort=10.0, payloads={"O_e": 5.0})
    assert np.isnan(at.greatest_wrench([0, 0, 1, 0, 0, 0]))
    assert at.effort_left(np.zeros(6)) < 0.0


def test_unknown_limits_are_named() -> None:
    robot = pm.load(_MACHINES / "ankle" / "ankle.xml", tool_frame="sole")
    at = pm.tool_capability(robot, robot.home)
    with pytest.raises(InvalidValueError, match=r"speed of left_motor"):
        at.greatest_twist(np.eye(6)[0])


@pytest.mark.parametrize("flat", [False, True], ids=["in space", "in a plane"])
def test_velocities_of_36_drives_are_a_zonotope(flat: bool) -> None:
    """Their box of rates has 2^36 corners. The support of a zonotope is the sum over drives; 36 + 35 + .. facets."""
    rates, speed = np.random.default_rng(2).normal(size=(6, 36)), np.linspace(0.5, 1.5, 36)
    rates[2] *= not flat
    drives, nothing = tuple(f"drive{k}" for k in range(36)), np.zeros(36)
    at = ToolCapability(drives, rates, np.eye(36), nothing, np.ones(36), speed)
    corners = at.velocities(slice(0, 3))
    assert len(corners) == (2 * 36 if flat else 36 * 35 + 2)
    for direction in np.random.default_rng(3).normal(size=(20, 3)):
        assert (corners @ direction).max() == pytest.approx(np.abs(direction @ rates[:3]) @ speed)


def test_velocities_of_redundant_drives() -> None:
    """Twelve drives for six freedoms; the support along a direction is a linear program over the independent rates."""
    generator = np.random.default_rng(5)
    tool, drives, speed = generator.normal(size=(6, 6)), generator.normal(size=(12, 6)), np.linspace(0.5, 1.5, 12)
    names = tuple(f"drive{k}" for k in range(12))
    corners = ToolCapability(names, tool, drives, np.zeros(6), np.ones(12), speed).velocities(slice(0, 3))
    rows, most = np.vstack([drives, -drives]), np.tile(speed, 2)
    for direction in generator.normal(size=(6, 3)):
        best = linprog(-direction @ tool[:3], A_ub=rows, b_ub=most, bounds=(None, None))
        assert (corners @ direction).max() == pytest.approx(-best.fun, rel=1e-8)


def test_velocities_of_many_redundant_drives_are_refused() -> None:
    drives, rates = tuple(f"drive{k}" for k in range(14)), np.ones((6, 12))
    at = ToolCapability(drives, rates, np.ones((14, 12)), np.zeros(12), np.ones(14), np.ones(14))
    with pytest.raises(InvalidValueError, match="14 drives for 12 freedoms"):
        at.velocities(slice(0, 3))


def test_the_command(answer: Callable[..., Any]) -> None:
    wrench = ["--wrench", "0", "0", "-500", "0", "0", "0", "--wrench", "0", "0", "500", "0", "10", "0"]
    twist = ["--twist", "0", "0", "0.1", "0", "0", "0"]
    result = answer("capability", "10", "-15", "0.5", "--effort", "400", *wrench, *twist)
    robot = pm.load("pm3dof")
    at = pm.tool_capability(robot, robot.solve([np.radians(10.0), np.radians(-15.0), 0.5]), effort=400.0)
    assert result["greatest_force_N"]["+"][:2] == [None, None]
    np.testing.assert_allclose(result["greatest_force_N"]["-"][2], at.greatest_wrench([0, 0, -1, 0, 0, 0]))
    np.testing.assert_allclose(result["effort_left"], [at.effort_left(w) for w in result["wrenches"]])
    assert result["times_held"][0] == pytest.approx(result["greatest_force_N"]["-"][2] / 500.0)
    assert result["times_reached"] == pytest.approx([result["greatest_speed_m_s"][2] / 0.1])
    corners = np.array(result["speed_polytope_m_s"])
    assert corners[:, 2].max() == pytest.approx(np.abs(at.tool_rates[2]) @ at.speed)  # all drives at full speed


def test_the_command_says_that_the_weight_is_not_held(run: Callable[..., Any]) -> None:
    result = run("capability", "--effort", "10", "--payload", "5")
    assert "cannot hold the weight" in result.stderr
    assert "none" in result.stdout
    found = run("capability", "--effort", "10", "--payload", "5", "--json")
    assert '"weight_is_held": false' in found.stdout


def test_the_wrench_feasible_workspace(answer: Callable[..., Any], tmp_path: Path) -> None:
    """By the torques that balance each wrench and the weight, of virtual power at every pose of a grid."""
    ranges = [
        "--range",
        "x",
        "-0.1",
        "0.1",
        "5",
        "--range",
        "y",
        "-0.1",
        "0.1",
        "5",
        "--range",
        "z",
        "0.1",
        "0.25",
        "4",
    ]
    wrenches = [[0.0, 0.0, -75.0, 0.0, 0.0, 0.0], [55.0, 0.0, 0.0, 0.0, 0.0, 0.0]]
    loads = [word for wrench in wrenches for word in ("--wrench", *map(str, wrench))]
    names = ["-q", "wrench_margin", "-q", "wrench_feasible"]
    place = ["--robot", "linear_delta", *ranges, *loads, *names]
    found = answer("evaluate", *place, "--out", str(tmp_path))["distributions"]
    robot = pm.load("linear_delta")
    poses = robot.solve(robot.grid(x=(-0.1, 0.1, 5), y=(-0.1, 0.1, 5), z=(0.1, 0.25, 4)))
    effort = np.array(robot.model.upperEffortLimit)[robot.actuated_indices]
    left = []
    for q in poses.q.reshape(-1, robot.model.nq):
        at = robot.configuration(q)
        null = np.linalg.svd(at.constraint_jacobian)[2][18:].T  # 21 joints
        rates = null @ np.linalg.inv(null[robot.actuated_indices])
        weight = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q)
        forces = [rates.T @ (weight + at.tool_jacobian.T @ wrench) for wrench in wrenches]
        left.append(min((1.0 - np.abs(force) / effort).min() for force in forces))
    margins = np.array(left)
    assert 0 < (margins >= 0.0).sum() < len(margins)
    assert found["wrench_margin"]["least"] == pytest.approx(margins.min(), abs=1e-9)
    assert found["wrench_margin"]["greatest"] == pytest.approx(margins.max(), abs=1e-9)
    assert 0.0 < found["wrench_feasible"]["mean"] < 1.0
    out = str(tmp_path / "atlas.nc")
    answer("atlas", *place, "--precision", "double", "--no-pictures", "--out", out)
    stored = pm.open_atlas(out)
    within = poses.within_limits.ravel()
    np.testing.assert_allclose(stored["wrench_margin"].values.ravel()[within], margins[within], atol=1e-9)
    assert (stored["wrench_feasible"].values.ravel()[within] == (margins >= 0.0)[within]).all()
