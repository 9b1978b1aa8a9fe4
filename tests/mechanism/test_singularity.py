from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

from pm3dof_pin.description.urdf_files import closure_entries
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularities, singularity_distances
from pm3dof_pin.mechanism.configuration import Configuration

CRANK, COUPLER, ROCKER, GROUND = 0.2, 0.5, 0.4, 0.6
PROXIMAL, DISTAL, PIVOTS = 0.3, 0.4, 0.2


def names(configuration: Configuration) -> list[str]:
    return [singularity.type for singularity in singularities(configuration)]


def rate(mechanism: Robot, motion: np.ndarray, joint: str) -> float:
    return float(motion[mechanism.velocity_indices([joint])[0], 0])


def angle_between(adjacent: float, other: float, opposite: float) -> float:
    """Angle between two sides of a triangle."""
    return float(np.arccos((adjacent**2 + other**2 - opposite**2) / (2.0 * adjacent * other)))


def dead_point(four_bar: Robot, folded: bool) -> Configuration:
    """Crank and coupler in one line: the triangle of their sum (folded: difference), rocker and ground."""
    reach = COUPLER - CRANK if folded else COUPLER + CRANK
    line = angle_between(reach, GROUND, ROCKER)
    rocker = np.pi - angle_between(GROUND, ROCKER, reach)
    q = {"crank_joint": line + np.pi * folded, "coupler_joint": np.pi * folded, "rocker_joint": rocker}
    configuration = four_bar.configuration([q[name] for name in four_bar.q_names])
    assert configuration.closure_residual < 1e-15
    return configuration


@pytest.mark.parametrize("folded", [False, True])
@pytest.mark.parametrize(
    ("driven", "tool", "expected"),
    [
        ("crank_joint", "coupler", []),
        ("crank_joint", "rocker", ["serial"]),
        ("rocker_joint", "coupler", ["parallel"]),
        ("rocker_joint", "rocker", ["passive"]),
    ],
)
def test_dead_point_of_a_four_bar(
    make_four_bar: Callable[..., Robot], folded: bool, driven: str, tool: str, expected: list[str]
) -> None:
    four_bar = make_four_bar(CRANK, COUPLER, ROCKER, GROUND, driven=driven, tool=tool)
    dead = dead_point(four_bar, folded)
    assert names(dead) == expected
    assert names(generic_configuration(dead)) == []
    for singularity in singularities(dead):
        assert singularity.measure < 1e-12
        # the rocker is at rest, and the ends of crank and coupler move relative to each other
        assert rate(four_bar, singularity.motions, "rocker_joint") == pytest.approx(0.0, abs=1e-12)
        crank, coupler = (rate(four_bar, singularity.motions, f"{name}_joint") for name in ("crank", "coupler"))
        assert CRANK * crank * (-1) ** folded + COUPLER * (crank + coupler) == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(singularity.twists, dead.tool_jacobian @ singularity.motions, atol=1e-15)


def test_a_flat_parallelogram_gains_a_freedom(make_four_bar: Callable[..., Robot]) -> None:
    parallelogram = make_four_bar(0.3, 0.5, 0.3, 0.5)
    flat = parallelogram.home
    assert flat.closure_residual < 1e-15
    assert instantaneous_mobility(flat).count == 2
    (singularity,) = singularities(flat)
    assert singularity.type == "constraint"
    assert singularity.measure < 1e-12
    # with the crank locked, coupler and rocker can still turn, and their common tip moves up
    crank, coupler, rocker = (
        rate(parallelogram, singularity.motions, f"{n}_joint") for n in ("crank", "coupler", "rocker")
    )
    assert crank == pytest.approx(0.0, abs=1e-12)
    assert 0.5 * coupler == pytest.approx(0.3 * rocker, rel=1e-12)
    for crank_angle in (-2.0, -0.01, 0.01, 1.0, 3.0):
        open_one = parallelogram.configuration([crank_angle, -crank_angle, crank_angle])
        assert open_one.closure_residual < 1e-15
        assert names(open_one) == []
        assert instantaneous_mobility(open_one).count == 1


def arm(pivot: float, tip: np.ndarray, elbow_up: float) -> tuple[float, float]:
    """Angles of pivot and elbow that bring an arm's tip to a point."""
    reach = tip - [pivot, 0.0]
    elbow = elbow_up * (np.pi - angle_between(PROXIMAL, DISTAL, float(np.hypot(*reach))))
    along = PROXIMAL + DISTAL * np.cos(elbow), DISTAL * np.sin(elbow)
    return float(np.arctan2(reach[1], reach[0]) - np.arctan2(along[1], along[0])), float(elbow)


def five_bar_at(five_bar: Robot, tip: np.ndarray, left_up: float = -1.0, right_up: float = 1.0) -> Configuration:
    left, right = arm(-PIVOTS / 2, tip, left_up), arm(PIVOTS / 2, tip, right_up)
    q = dict(
        zip(
            ("x_joint", "y_joint", "left_joint", "left_elbow", "right_joint", "right_elbow"),
            (*tip, *left, *right),
            strict=True,
        )
    )
    configuration = five_bar.configuration([q[name] for name in five_bar.q_names])
    assert configuration.closure_residual < 1e-9
    return configuration


def test_a_stretched_arm_of_a_five_bar_is_serial(five_bar: Robot) -> None:
    direction = np.array([np.cos(1.4), np.sin(1.4)])
    stretched = five_bar_at(five_bar, np.array([-PIVOTS / 2, 0.0]) + (PROXIMAL + DISTAL - 1e-15) * direction)
    (singularity,) = singularities(stretched)
    assert singularity.type == "serial"
    assert rate(five_bar, singularity.motions, "right_joint") == pytest.approx(0.0, abs=1e-6)
    assert abs(rate(five_bar, singularity.motions, "left_joint")) > 0.1
    np.testing.assert_allclose(singularity.twists, 0.0, atol=1e-6)


def test_distal_links_in_one_line_are_parallel(make_five_bar: Callable[..., Robot]) -> None:
    five_bar = make_five_bar(PROXIMAL, PROXIMAL, PIVOTS)
    # elbows at the same height, two distal links apart
    pivot = np.arccos((PIVOTS - 2.0 * PROXIMAL) / (2.0 * PROXIMAL))
    height = PROXIMAL * np.sin(pivot)
    q = {
        "x_joint": 0.0,
        "y_joint": height,
        "left_joint": pivot,
        "left_elbow": -pivot,
        "right_joint": np.pi - pivot,
        "right_elbow": pivot,
    }
    aligned = five_bar.configuration([q[name] for name in five_bar.q_names])
    assert aligned.closure_residual < 1e-15
    (singularity,) = singularities(aligned)
    assert singularity.type == "parallel"
    assert singularity.measure < 1e-12
    # the tool moves across the line of the links, with both pivots at rest
    twist = singularity.twists[:, 0] / np.linalg.norm(singularity.twists)
    np.testing.assert_allclose(np.abs(twist), [0, 1, 0, 0, 0, 0], atol=1e-12)
    for joint in five_bar.actuated_joints:
        assert rate(five_bar, singularity.motions, joint) == pytest.approx(0.0, abs=1e-12)


def test_a_tool_on_a_pivot_leaves_the_folded_arm_free(make_five_bar: Callable[..., Robot]) -> None:
    five_bar = make_five_bar(PROXIMAL, PROXIMAL, PIVOTS, driven="left_elbow, right_joint")
    right = np.arccos(PIVOTS / 2 / PROXIMAL)
    q = {
        "x_joint": -PIVOTS / 2,
        "y_joint": 0.0,
        "left_joint": 0.8,
        "left_elbow": np.pi,
        "right_joint": np.pi - right,
        "right_elbow": 2.0 * right,
    }
    folded = five_bar.configuration([q[name] for name in five_bar.q_names])
    assert folded.closure_residual < 1e-15
    (singularity,) = singularities(folded)
    assert singularity.type == "passive"
    others = [joint for joint in five_bar.q_names if joint != "left_joint"]
    for joint in others:
        assert rate(five_bar, singularity.motions, joint) == pytest.approx(0.0, abs=1e-12)
    assert abs(rate(five_bar, singularity.motions, "left_joint")) == pytest.approx(1.0)


def test_a_five_bar_is_regular_elsewhere(five_bar: Robot) -> None:
    rng = np.random.default_rng(5)
    regular = 0
    while regular < 50:
        tip = rng.uniform([-0.5, 0.05], [0.5, 0.65])
        reaches = [np.hypot(tip[0] + side * PIVOTS / 2, tip[1]) for side in (1.0, -1.0)]
        if not all(DISTAL - PROXIMAL + 1e-3 < reach < DISTAL + PROXIMAL - 1e-3 for reach in reaches):
            continue
        configuration = five_bar_at(five_bar, tip)
        distal = [configuration.frame_placement(f"{side}_distal").rotation[:2, 0] for side in ("left", "right")]
        if abs(np.cross([*distal[0], 0.0], [*distal[1], 0.0])[2]) < 1e-3:
            continue
        assert names(configuration) == []
        regular += 1


def test_measures_fall_on_the_way_to_a_singularity(five_bar: Robot) -> None:
    generic = instantaneous_mobility(generic_configuration(five_bar_at(five_bar, np.array([0.0, 0.5]))))
    top = np.sqrt((PROXIMAL + DISTAL) ** 2 - (PIVOTS / 2) ** 2)
    measures = []
    for distance in (1e-2, 1e-4, 1e-6):
        near = five_bar_at(five_bar, np.array([0.0, top - distance]))
        assert singularities(near, generic=generic) == ()
        measures.append(instantaneous_mobility(near).tool_rank.singular_values[1])
    assert measures[0] > 5.0 * measures[1] > 25.0 * measures[2]


@pytest.mark.parametrize(
    ("q", "expected"),
    [
        ([0.1, -1.0, 1.2, 0.3, 0.8, 0.2], []),
        ([0.1, -1.0, 0.0, 0.3, 0.8, 0.2], ["serial"]),
        ([0.1, -1.0, 1.2, 0.3, 0.0, 0.2], ["serial"]),
        ([0.1, -1.0, 1e-2, 0.3, 1e-2, 0.2], []),
    ],
)
def test_serial_arm_is_singular_with_elbow_or_wrist_straight(ur5: Robot, q: list[float], expected: list[str]) -> None:
    assert names(ur5.configuration(q)) == expected


def test_a_redundant_arm_is_not_singular_for_its_self_motion() -> None:
    import example_robot_data

    panda = Robot(example_robot_data.load("panda").model, tool_frame="panda_hand")
    configuration = panda.configuration([0.1, -0.5, 0.3, -1.8, 0.2, 1.5, 0.4, 0.0, 0.0])
    mobility = instantaneous_mobility(configuration)
    assert (mobility.count, mobility.tool_mobility) == (9, 6)
    assert singularities(configuration) == ()


def wrench_determinant(gough: Any, placement: pin.SE3) -> float:
    """Determinant of the legs' unit wrenches at the platform: zero where it can move with the legs locked."""
    arms = gough.heads @ placement.rotation.T
    legs = arms + placement.translation - gough.feet
    units = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    return float(np.linalg.det(np.hstack([units, np.cross(arms, units) / 0.1])))


def test_gough_platform_turned_about_its_axis_becomes_parallel(gough: Any) -> None:
    def placement(turn: float) -> pin.SE3:
        return pin.SE3(pin.utils.rotate("z", turn) @ pin.utils.rotate("x", 0.05), np.array([0.0, 0.0, 0.1]))

    turns = np.linspace(0.0, 2.5, 26)
    values = [wrench_determinant(gough, placement(turn)) for turn in turns]
    crossing = int(np.flatnonzero(np.diff(np.sign(values)))[0])
    turn = brentq(lambda t: wrench_determinant(gough, placement(t)), turns[crossing], turns[crossing + 1], xtol=1e-15)

    def configuration(turn: float) -> Configuration:
        return gough.mechanism.assemble(joints={"platform_joint": pin.SE3ToXYZQUAT(placement(turn))})

    (singularity,) = singularities(configuration(turn))
    assert singularity.type == "parallel"
    assert singularity.measure < 1e-10
    assert np.linalg.norm(singularity.twists) > 0.1
    assert names(configuration(turn - 0.05)) == []


def test_a_point_tool_is_the_same_on_either_body(make_five_bar: Callable[..., Robot]) -> None:
    """A straight left leg moves with the point at rest: serial, whichever of the two links carries the tool frame."""
    five_bar = make_five_bar(PROXIMAL, DISTAL, PIVOTS)
    reach = PROXIMAL + DISTAL
    stretched = five_bar_at(five_bar, np.array([-PIVOTS / 2 + reach * np.cos(1.1), reach * np.sin(1.1)]))
    found: dict[str, list[list[str]]] = {}
    for count, tool_motions in (("all", ()), ("point", ("x", "y"))):
        for tip in ("left_tip", "right_tip"):
            robot = five_bar.replace(tool_frame=tip, tool_motions=tool_motions, motion_coordinates=())
            found.setdefault(count, []).append(names(robot.configuration(stretched.q)))
    assert found["point"] == [["serial"], ["serial"]]
    assert found["all"][0] != found["all"][1]


def test_distances_fall_linearly_to_zero_and_name_the_motion() -> None:
    """The hexapod with its platform turned by nearly 90 degrees about its axis."""
    hexapod = Robot.load("hexapod")
    generic = instantaneous_mobility(generic_configuration(hexapod.home))
    measures = {}
    for degrees in (89.0, 89.9, 89.99):
        turned = hexapod.solve([0.0, 0.0, 0.135, 0.0, 0.0, np.radians(degrees)]).configuration()
        assert singularities(turned, generic=generic) == ()
        distances = {entry.type: entry for entry in singularity_distances(turned, generic=generic)}
        assert set(distances) == {"constraint", "parallel", "serial", "passive"}
        nearest = distances["parallel"]
        measures[degrees] = nearest.measure
        # the drives move by no more than this in it, while the platform turns
        drives = nearest.motion[hexapod.actuated_indices] / hexapod.characteristic_length
        assert np.linalg.norm(drives) == pytest.approx(nearest.measure, rel=1e-6)
        assert abs(nearest.twist[5]) > 0.2
        np.testing.assert_allclose(turned.constraint_jacobian @ nearest.motion, 0.0, atol=1e-12)
        np.testing.assert_allclose(turned.tool_jacobian @ nearest.motion, nearest.twist, atol=1e-12)
    assert measures[89.0] / measures[89.9] == pytest.approx(10.0, rel=0.02)
    assert measures[89.9] / measures[89.99] == pytest.approx(10.0, rel=0.002)


def test_tool_motions_are_read_and_written(tmp_path: Path) -> None:
    source = Path(__file__).parents[1] / "machines" / "five_bar"
    for file in source.iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    closures = tmp_path / "five_bar.closures.yaml"
    closures.write_text(closures.read_text() + "tool_motions: [x, y]\n")
    robot = Robot.load(tmp_path)
    assert robot.tool_motions == ("x", "y")
    assert instantaneous_mobility(robot.home).tool_mobility == 2
    assert closure_entries(robot.description)["tool_motions"] == ["x", "y"]
    closures.write_text(closures.read_text().replace("[x, y]", "[x, w]"))
    with pytest.raises(DescriptionError, match="tool_motions"):
        Robot.load(tmp_path)
