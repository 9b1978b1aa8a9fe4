"""Quantities of maps on robots of every kind, against closed forms and the underlying engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.chapter_stiffness import chapter_stiffness, global_index
from pm3dof_pin.chapter.elastic_stiffness import contribution_names, elastic_stiffness, spring_contributions
from pm3dof_pin.chapter.kinematics import inverse_kinematics
from pm3dof_pin.cli import completion
from pm3dof_pin.dynamics.batch import natural_frequencies
from pm3dof_pin.dynamics.receptance import vibrating_system
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.export.description import temporary_description
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.atlas import open_atlas
from pm3dof_pin.maps.datasets import unit_of_entry
from pm3dof_pin.maps.quantities import QUANTITIES, quantity, select_quantities
from pm3dof_pin.maps.quantity import Evaluation, MappedRobot, Quantity
from pm3dof_pin.typing import Array, Engine
from pm3dof_pin.viewer.layers import ScalarQuantity

MACHINES = Path(__file__).parents[1] / "machines"


def compute(evaluation: Evaluation, name: str) -> Array:
    return compute_by(QUANTITIES, evaluation, name)


def compute_by(table: Mapping[str, Quantity], evaluation: Evaluation, name: str) -> Array:
    return table[name].compute(evaluation)


@pytest.fixture(scope="module")
def tripod_poses(slender: Robot, reachable_poses: np.ndarray) -> Evaluation:
    return Evaluation(MappedRobot(slender), slender.solve(reachable_poses))


def test_all_of_the_tripod_at_10_000_poses(
    tripod_poses: Evaluation, tripod: Tripod, reachable_poses: np.ndarray
) -> None:
    stiffness = elastic_stiffness(tripod, reachable_poses)
    scale = np.sqrt(np.einsum("nii->ni", stiffness))
    unit = scale[:, :, None] * scale[:, None, :]
    for name in ("K", "stiffness"):
        assert np.abs((compute(tripod_poses, name) - stiffness) / unit).max() < 1e-10
    compliance = np.linalg.inv(stiffness / unit) / unit
    for name in ("C", "compliance"):
        assert np.abs((compute(tripod_poses, name) - compliance) * unit).max() < 1e-8
    felt = compute(tripod_poses, "felt_stiffness")
    np.testing.assert_allclose(felt, 1.0 / np.einsum("nii->ni", compliance), rtol=1e-9)
    for name, rows in (("translational_stiffness", slice(0, 3)), ("rotational_stiffness", slice(3, 6))):
        block = np.linalg.inv(compliance[:, rows, rows])
        np.testing.assert_allclose(compute(tripod_poses, name), np.linalg.eigvalsh(block), rtol=1e-7)
    length = np.sqrt(
        np.trace(stiffness[:, 3:, 3:], axis1=1, axis2=2) / np.trace(stiffness[:, :3, :3], axis1=1, axis2=2)
    )
    np.testing.assert_allclose(compute(tripod_poses, "characteristic_length"), length, rtol=1e-9)
    change = np.ones((len(length), 6))
    change[:, 3:] = 1.0 / length[:, None]
    values = np.linalg.eigvalsh(stiffness * change[:, :, None] * change[:, None, :])
    np.testing.assert_allclose(compute(tripod_poses, "eigenvalues")[:, 1:], values[:, 1:], rtol=1e-6)
    np.testing.assert_allclose(compute(tripod_poses, "condition_number"), values[:, -1] / values[:, 0], rtol=1e-4)
    travels = inverse_kinematics(tripod, reachable_poses)
    for name in ("commands", "slider_travel"):
        np.testing.assert_allclose(compute(tripod_poses, name), travels, atol=1e-11)
    diagonal = chapter_stiffness(tripod, reachable_poses)
    np.testing.assert_allclose(compute(tripod_poses, "chapter_diagonal"), diagonal, rtol=1e-9)
    np.testing.assert_allclose(compute(tripod_poses, "chapter_global"), global_index(diagonal), rtol=1e-9)


def test_engines_agree(mechanism: Robot, reachable_poses: np.ndarray) -> None:
    robots = (mechanism, mechanism.with_engine("pinocchio"))
    evaluations = [Evaluation(MappedRobot(robot), robot.solve(reachable_poses[:40])) for robot in robots]
    for name in ("C", "felt_stiffness", "translational_stiffness", "condition_number", "commands"):
        program, pinocchio = (compute(evaluation, name) for evaluation in evaluations)
        np.testing.assert_allclose(program, pinocchio, rtol=1e-7, atol=1e-12 * np.abs(pinocchio).max())


def test_spring_shares_of_the_tripod(slender: Robot, tripod: Tripod, reachable_poses: np.ndarray) -> None:
    poses = reachable_poses[:5]
    mapped = MappedRobot(slender)
    found = compute(Evaluation(mapped, slender.solve(poses)), "spring_shares")
    contributions = np.einsum("njii->nij", spring_contributions(tripod, poses))
    expected = contributions / contributions.sum(axis=-1, keepdims=True)
    order = [contribution_names(tripod).index(name) for name in QUANTITIES["spring_shares"].dims[1].labels(mapped)]
    np.testing.assert_allclose(found, expected[..., order], atol=1e-8)


def test_natural_frequencies_are_those_at_each_pose(mechanism: Robot, reachable_poses: np.ndarray) -> None:
    poses = mechanism.solve(np.concatenate([reachable_poses[:5], [[0.0, 0.0, 2.0]]]), on_failure="nan").reshape(2, 3)
    evaluation = Evaluation(MappedRobot(mechanism), poses)
    found = compute(evaluation, "natural_frequencies").reshape(6, 6)
    expected = natural_frequencies(ElasticModel.load("pm3dof"), poses.q.reshape(6, -1)[:5], count=6)
    np.testing.assert_allclose(found[:5], expected, rtol=1e-9)
    np.testing.assert_allclose(compute(evaluation, "first_frequency").ravel()[:5], expected[:, 0], rtol=1e-9)
    assert np.isnan(found[5]).all()


def test_another_tripod_has_the_chapters_numbers_too(tmp_path: Path) -> None:
    from pm3dof_pin.description.parameters import _default_parameters_path

    text = _default_parameters_path().read_text()
    assert "value: 353.0, unit: mm" in text  # the links
    config = tmp_path / "longer.yaml"
    config.write_text(text.replace("value: 353.0, unit: mm", "value: 354.0, unit: mm"))
    robot = Robot.load(temporary_description("pm3dof", config))
    pose = [0.1, -0.2, 0.5]
    found = compute(Evaluation(MappedRobot(robot), robot.solve([pose])), "chapter_diagonal")[0]
    np.testing.assert_allclose(found, chapter_stiffness(Tripod.load(config), pose), rtol=1e-9)


@pytest.mark.parametrize("name", ["hexapod", "three_rps"])
def test_the_chapters_numbers_are_the_tripods_alone(name: str) -> None:
    mapped = MappedRobot(Robot.load(name))
    with pytest.raises(InvalidValueError, match=r"has no chapter_global \(it lacks.*expected K, stiffness"):
        select_quantities(["chapter_global"], mapped)


def hexapod_stiffness(robot: Robot, coordinates: Array) -> Array:
    """K = J^T k J of six axial springs between base and platform joints, from the model at home."""
    frames = {frame.name: index for index, frame in enumerate(robot.model.frames)}
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.home.q)
    tool = data.oMf[frames["O_e"]]
    base = np.array(
        [data.oMi[robot.model.getJointId(f"universal{leg}_first_joint")].translation for leg in range(1, 7)]
    )
    corner = np.array([tool.actInv(data.oMf[frames[f"B{leg}"]]).translation for leg in range(1, 7)])
    stiffness = np.zeros((6, 6))
    rotation = pin.utils.rotate("x", coordinates[3]) @ pin.utils.rotate("y", coordinates[4])
    rotation = rotation @ pin.utils.rotate("z", coordinates[5])
    for start, point in zip(base, corner, strict=True):
        arm = rotation @ point
        strut = coordinates[:3] + arm - start
        row = np.concatenate([strut, np.cross(arm, strut)]) / np.linalg.norm(strut)
        stiffness += 2e7 * np.outer(row, row)
    return stiffness


def test_the_hexapod_is_six_springs() -> None:
    robot = Robot.load("hexapod")
    generator = np.random.default_rng(4)
    coordinates = generator.uniform(
        [-0.008, -0.008, 0.13, -0.06, -0.06, -0.06], [0.008, 0.008, 0.14, 0.06, 0.06, 0.06], (20, 6)
    )
    evaluation = Evaluation(MappedRobot(robot), robot.solve(coordinates))
    expected = np.array([hexapod_stiffness(robot, row) for row in coordinates])
    found = compute(evaluation, "K")
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    assert select_quantities(["free_stiffness"], evaluation.mapped)[0].unit_for(evaluation.mapped) == (
        "N/m (x, y, z), N m/rad (rx, ry, rz)"
    )


def test_a_five_bar_has_the_stiffness_of_its_free_motions() -> None:
    """k of both motors through the elbows: 1/2 k dq^2, with the cranks' rotations dq for a motion of the pen."""
    robot = Robot.load(MACHINES / "five_bar" / "five_bar.urdf")
    mapped = MappedRobot(robot)
    pens = np.array([[0.0, 0.42], [0.03, 0.4], [-0.05, 0.44]])
    evaluation = Evaluation(mapped, robot.solve(pens))
    assert np.isnan(compute(evaluation, "K")).all()
    free = compute(evaluation, "free_stiffness")
    assert QUANTITIES["free_stiffness"].dims[0].labels(mapped) == ("x", "y")

    def cranks(pen: Array) -> Array:
        """Angles of the upper arms, 0.25 m long, on motors at x = -0.1 and 0.1 m; the forearms are 0.35 m long."""
        angles = []
        for side in (-1.0, 1.0):
            away = pen - [0.1 * side, 0.0]
            distance = np.hypot(*away)
            opening = np.arccos((0.25**2 + distance**2 - 0.35**2) / (2.0 * 0.25 * distance))
            angles.append(np.arctan2(away[1], away[0]) - side * opening)
        return np.array(angles)

    for pen, stiffness in zip(pens, free, strict=True):
        step = 1e-5
        jacobian = np.stack([(cranks(pen + e) - cranks(pen - e)) / (2 * step) for e in step * np.eye(2)], axis=1)
        np.testing.assert_allclose(stiffness, 5e3 * jacobian.T @ jacobian, rtol=1e-7, atol=1e-3)
    felt = compute(evaluation, "felt_stiffness")
    np.testing.assert_allclose(felt[:, :2], 1.0 / np.einsum("nii->ni", np.linalg.inv(free)), rtol=1e-9)
    assert np.isinf(felt[:, 2]).all()


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_a_serial_arm_is_its_springs_one_behind_the_other(engine: Engine) -> None:
    """C = J k^-1 J^T, with J of Pinocchio's own model."""
    import example_robot_data

    robot = Robot(example_robot_data.load("ur5").model, tool_frame="ee_link", engine=engine)
    k = np.array([4e4, 4e4, 2e4, 1e4, 1e4, 1e4])
    springs = [JointSpring(name, name, s, "N m/rad") for name, s in zip(robot.actuated_joints, k, strict=True)]
    mapped = MappedRobot(ElasticModel(robot, springs))
    q = np.random.default_rng(2).uniform(-1.5, 1.5, (30, 6))
    evaluation = Evaluation(mapped, robot.at(q))
    frame = robot.model.getFrameId("ee_link")
    for row, found in zip(q, compute(evaluation, "C"), strict=True):
        data = robot.model.createData()
        jacobian = pin.computeFrameJacobian(robot.model, data, row, frame, pin.LOCAL_WORLD_ALIGNED)
        expected = jacobian @ np.diag(1.0 / k) @ jacobian.T
        np.testing.assert_allclose(found, expected, atol=1e-13 * np.abs(expected).max() + 1e-20)
    np.testing.assert_array_equal(compute(evaluation, "commands"), q)
    assert QUANTITIES["commands"].unit_for(mapped) == "rad"


def test_a_robot_without_springs_has_commands_and_no_stiffness() -> None:
    import example_robot_data

    robot = Robot(example_robot_data.load("ur5").model, tool_frame="ee_link")
    evaluation = Evaluation(MappedRobot(robot), robot.at(np.zeros((2, 6))))
    np.testing.assert_array_equal(compute(evaluation, "commands"), np.zeros((2, 6)))
    with pytest.raises(DescriptionError, match="springs"):
        compute(evaluation, "K")


def test_a_quantity_of_ones_own_is_an_entry_of_the_table(
    mechanism: Robot, run: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From then on the library, the command, its list and its completion know it."""
    table = dict(QUANTITIES)
    for module in ("maps.quantities", "viewer.layers"):
        monkeypatch.setattr(f"pm3dof_pin.{module}.QUANTITIES", table)

    @quantity("height", unit="m", long_name="height of the tool")
    def height(evaluation: Evaluation) -> Array:
        return evaluation.poses.positions[..., 2]

    assert table["height"].compute is height
    mapped = MappedRobot(mechanism)
    assert compute_by(table, Evaluation(mapped, mechanism.solve([[0.1, 0.2, 0.5]])), "height") == pytest.approx(0.5)
    assert "height: height of the tool [m]" in run("atlas", "--list").stdout
    assert completion.quantities("hei") == ["height"]
    assert "height" in ScalarQuantity.names(mapped)
    path = tmp_path / "atlas.nc"
    ranges = ["--range", "z_e", "0.48", "0.5", "3", "-q", "height", "--no-pictures", "--out", str(path)]
    assert run("atlas", *ranges).returncode == 0
    with open_atlas(path) as maps:
        np.testing.assert_allclose(maps["height"].values, maps["z_e"].values, rtol=1e-6)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "linear_delta", "three_rps"])
def test_every_quantity_has_the_shape_and_units_it_says(name: str) -> None:
    robot = Robot.load(name)
    evaluation = Evaluation(MappedRobot(robot), robot.solve(np.tile(robot.home_coordinates, (2, 1))))
    for entry in QUANTITIES.values():
        if entry.exists(evaluation.mapped):
            assert entry.compute(evaluation).shape == (2, *entry.shape_for(evaluation.mapped)), entry.name
            assert entry.unit_for(evaluation.mapped), entry.name


def test_units_of_entries() -> None:
    units = "N/m (x, y, z), N m/rad (rx, ry, rz)"
    assert unit_of_entry(units, "y") == "N/m"
    assert unit_of_entry(units, "rz") == "N m/rad"
    assert unit_of_entry("Hz", "3") == "Hz"


def test_chatter_free_cutting_is_that_of_the_most_negative_receptance() -> None:
    """-1 / (2 min Re G) of the tool along z, from the receptance over a fine sweep of frequencies."""
    robot = Robot.load("pm3dof")
    poses = robot.solve(robot.grid(z_e=(0.45, 0.53, 2)))
    found = QUANTITIES["chatter_free_cutting"].compute(Evaluation(MappedRobot(robot), poses))
    for row, limits in enumerate(found):
        system = vibrating_system(ElasticModel(robot), poses.q[row])
        tool = system.rows(["tool:z"])
        direct = system.receptance(system.frequencies_around_modes(), tool, tool)[:, 0, 0]
        assert limits[2] == pytest.approx(-0.5 / direct.real.min(), rel=5e-3)
