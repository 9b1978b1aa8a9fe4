"""The stiffness over the whole workspace, against plain NumPy with the formulas and weights of the theory page."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.maps.workspace_evaluation import _cell_volumes, evaluate_workspace

AXES = ["x", "y", "z", "rx", "ry", "rz"]
MACHINES = Path(__file__).parents[1] / "machines"
ALPHA = np.radians([-30.0, 90.0, -150.0])
OUT = np.stack([np.cos(ALPHA), np.sin(ALPHA), 0.0 * ALPHA], axis=1)
GUIDES = np.array([-1.0, -1.0, 1.0]) * (
    np.cos(np.radians(50.0)) * np.stack([np.cos(ALPHA), np.sin(ALPHA), np.tan(np.radians(50.0)) + 0.0 * ALPHA], axis=1)
)
CLAMP = 0.379178  # docs/table_8_3.md, recovered to 4e-6


def tripod_stiffness(theta_x: float, theta_y: float, z: float, stiffer: int = -1) -> np.ndarray:
    """K by Theory, with one of actuator1 .. actuator3, link1 .. link3, passive leg stiffer by a tenth."""
    k = np.array([9.595e7] * 3 + [1.5177e10] * 3 + [1.0])
    if stiffer >= 0:
        k[stiffer] *= 1.1
    sx, cx, sy, cy = np.sin(theta_x), np.cos(theta_x), np.sin(theta_y), np.cos(theta_y)
    R = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    arms = (0.075 * OUT + [0.0, 0.0, 0.013]) @ R.T
    K = np.zeros((6, 6))
    for i in range(3):
        w = arms[i] + [0.0, 0.0, z] - 0.37425 * OUT[i]
        along = w @ GUIDES[i]
        n = (w - (along - np.sqrt(along**2 - w @ w + 0.353**2)) * GUIDES[i]) / 0.353
        wrench = np.append(n, np.cross(arms[i], n))
        K += np.outer(wrench, wrench) / ((n @ GUIDES[i]) ** 2 / k[i] + 1.0 / k[3 + i])
    EI, GJ, L = 899.6698 * k[6], 697.4185 * k[6], z - CLAMP
    poisson = EI / GJ - 1.0
    KGA = 6.0 * (1.0 + poisson) / (7.0 + 6.0 * poisson) * 2.0 * GJ / 0.0086**2  # of a round bar, by Cowper
    C = np.diag([L**3 / (3 * EI) + L / KGA] * 2 + [0.0] + [L / EI] * 2 + [L / GJ])
    C[0, 4] = C[4, 0] = L**2 / (2 * EI)
    C[1, 3] = C[3, 1] = -(L**2) / (2 * EI)
    S = np.zeros((3, 6))
    S[0, 0] = S[1, 1] = 1.0
    S[2, 4:] = -sx, cx
    return K + S.T @ np.linalg.inv(S @ C @ S.T) @ S


def test_the_tripod(mechanism: Robot) -> None:
    grid = mechanism.grid(theta_x=(-0.6, 0.6, 7), theta_y=(-0.6, 0.6, 7), z_e=(0.42, 0.56, 5))
    found = evaluate_workspace(MappedRobot(mechanism), grid, ("felt_stiffness",))
    flags = found.dataset["broken_limits"].values
    weights, felt, conditions, diagonals, stiffer = [], [], [], [], []
    for i, j, k in itertools.product(range(7), range(7), range(5)):
        if flags[i, j, k]:
            continue
        pose = (-0.6 + 0.2 * i, -0.6 + 0.2 * j, 0.42 + 0.035 * k)
        weights.append((0.5 if i in (0, 6) else 1.0) * (0.5 if j in (0, 6) else 1.0) * (0.5 if k in (0, 4) else 1.0))
        K = tripod_stiffness(*pose)
        felt.append(1.0 / np.diagonal(np.linalg.inv(K)))
        stiffer.append([1.0 / np.diagonal(np.linalg.inv(tripod_stiffness(*pose, spring))) for spring in range(7)])
        length = np.sqrt((K[3, 3] + K[4, 4] + K[5, 5]) / (K[0, 0] + K[1, 1] + K[2, 2]))
        scale = np.diag([1.0] * 3 + [1.0 / length] * 3)
        conditions.append(1.0 / np.linalg.cond(scale @ K @ scale))
        diagonals.append(np.trace(K) / 6.0)
    w = np.array(weights) / np.sum(weights)
    values, gains = np.array(felt), np.array(stiffer) / np.array(felt)[:, None] - 1.0
    assert found.reachable == pytest.approx(np.sum(weights) / (6.0 * 6.0 * 4.0), rel=1e-12)
    assert 0.2 < found.reachable < 0.9
    for entry, column in zip(found.distributions, values.T, strict=True):
        mean = w @ column
        assert entry.mean == pytest.approx(mean, rel=2e-5)
        assert entry.standard_deviation == pytest.approx(np.sqrt(w @ (column - mean) ** 2), rel=2e-5)
        assert (entry.least, entry.greatest) == pytest.approx((column.min(), column.max()), rel=2e-5)
        for place, value in ((entry.least_at, entry.least), (entry.greatest_at, entry.greatest)):
            axis = AXES.index(entry.entry)
            again = 1.0 / np.linalg.inv(tripod_stiffness(*place.values()))[axis, axis]
            assert again == pytest.approx(value, rel=2e-5)
    assert found.indices["mean_diagonal"] == pytest.approx(w @ diagonals, rel=2e-5)
    assert found.indices["conditioning"] == pytest.approx(w @ conditions, rel=2e-5)
    assert found.indices["least_conditioning"] == pytest.approx(np.min(conditions), rel=2e-5)
    names = [*(f"actuator{leg}" for leg in (1, 2, 3)), *(f"link{leg}" for leg in (1, 2, 3)), "passive_leg"]
    assert len(found.springs) == 42
    for rank in found.springs:  # the true effect of a tenth more, solved again, is between both numbers
        true = w @ gains[:, names.index(rank.spring), AXES.index(rank.axis)]
        assert rank.gain_of_10_percent_at_least - 1e-6 <= true <= rank.gain_of_10_percent_at_most + 1e-6
        assert rank.gain_of_10_percent_at_most == pytest.approx(0.1 * rank.mean_share)  # its tangent at no change
    for axis in AXES:
        ranks = [rank for rank in found.springs if rank.axis == axis]
        assert sum(rank.governs_part for rank in ranks) == pytest.approx(1.0)
        assert sum(rank.mean_share for rank in ranks) == pytest.approx(1.0)
    critical, order = found.dataset["critical_spring"].sel(axis="z").values, list(found.dataset["spring"].values)
    for row, number in enumerate(critical[flags == 0]):
        brings = gains[row, :, 2]
        assert brings[names.index(order[number - 1])] > 0.97 * brings.max()


def test_a_planar_machine() -> None:
    """Free motions only: K = sum of k w w^T over three cylinders in the plane, and nothing of the other three axes."""
    robot = Robot.load(str(MACHINES / "three_rpr"))
    grid = robot.grid(px=(-0.04, 0.04, 3), py=(-0.04, 0.04, 3), phi=(-0.2, 0.2, 5))
    found = evaluate_workspace(MappedRobot(robot), grid, ("free_stiffness",))
    angles = np.array([-1.7448284687773046, 0.3495666336158911, 2.443961736009086])  # of the file
    bases = 0.5 * np.stack([np.cos(np.radians([90, 210, 330])), np.sin(np.radians([90, 210, 330]))], axis=1)
    tips = bases + 0.44240393197997924 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    tool = tips[0] + [0.07660444431189779, -0.06427876096865395]
    diagonals, conditions = [], []
    for x, y, phi in itertools.product(
        np.linspace(-0.04, 0.04, 3), np.linspace(-0.04, 0.04, 3), np.linspace(-0.2, 0.2, 5)
    ):
        R = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
        K = np.zeros((3, 3))
        for tip, base in zip(tips, bases, strict=True):
            arm = R @ (tip - tool)
            n = np.array([x, y]) + arm - base
            n /= np.linalg.norm(n)
            wrench = np.array([n[0], n[1], arm[0] * n[1] - arm[1] * n[0]])
            K += 1e6 * np.outer(wrench, wrench)
        diagonals.append(np.diagonal(K))
        length = np.sqrt(K[2, 2] / (K[0, 0] + K[1, 1]))
        conditions.append(1.0 / np.linalg.cond(K / np.outer([1, 1, length], [1, 1, length])))
    weights = np.einsum("i,j,k->ijk", [0.5, 1, 0.5], [0.5, 1, 0.5], [0.5, 1, 1, 1, 0.5]).ravel()
    weights /= weights.sum()
    assert found.reachable == 1.0
    for entry, column in zip(found.distributions, np.array(diagonals).T, strict=True):
        assert entry.mean == pytest.approx(weights @ column, rel=1e-9)
    assert {rank.axis for rank in found.springs} == {"x", "y", "rz"}
    assert found.indices["conditioning"] == pytest.approx(weights @ conditions, rel=1e-9)
    assert found.indices["mean_diagonal"] == pytest.approx(weights @ np.mean(diagonals, axis=1), rel=1e-9)


def test_volumes_do_not_depend_on_the_density_of_the_grid(mechanism: Robot) -> None:
    coarse, fine = (mechanism.grid(theta_x=(-0.5, 0.5, n), z_e=(0.45, 0.5, 2 * n)) for n in (4, 9))
    for grid in (coarse, fine):
        volumes = _cell_volumes(grid)
        assert volumes.sum() == pytest.approx(1.0 * 0.05)
        # and are those of both neighbours' halves: what is linear in a coordinate is integrated exactly
        tilt, height = np.meshgrid(grid.axes["theta_x"], grid.axes["z_e"], indexing="ij")
        integral = np.sum(volumes * ((1.0 + tilt) * (1.0 + height)).reshape(volumes.shape))
        assert integral == pytest.approx(1.0 * (0.05 + 0.5 * (0.5**2 - 0.45**2)), rel=1e-12)


def test_nothing_within_the_limits(mechanism: Robot) -> None:
    with pytest.raises(UnreachablePoseError, match="no pose of the grid"):
        evaluate_workspace(MappedRobot(mechanism), mechanism.grid(z_e=(0.7, 0.8, 3)))


@pytest.mark.usefixtures("unpainted")
def test_the_command(answer: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    words = ("evaluate", "--robot", "pm3dof", "--points", "5", "--out", "out")
    result = answer(*words, cwd=tmp_path)
    assert set(result) >= {"distributions", "global_indices", "springs", "reachable_part"}
    felt = result["distributions"]["felt_stiffness_z"]
    assert felt["least"] <= felt["mean"] <= felt["greatest"]
    assert set(felt["least_at"]) == {"theta_x_rad", "theta_y_rad", "z_e_m"}
    lines = (tmp_path / "out" / "evaluation.csv").read_text().splitlines()
    assert len(lines) == 1 + len(result["distributions"])
    chapter = answer("evaluate", "--model", "chapter", "--points", "5", "--out", "out", cwd=tmp_path)
    assert "chapter_global" in chapter["distributions"]
    assert "springs" not in chapter
