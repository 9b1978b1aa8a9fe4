"""Natural modes against formulas for small systems and an evaluation of the tripod without virtual joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import joint_positions, link_vectors, placement
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.dynamics.batch import natural_frequencies
from pm3dof_pin.dynamics.beam_masses import vibrating_mass
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import AxialSpring, CantileverSpring, JointSpring, Spring
from pm3dof_pin.exceptions import FrameNotFoundError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot


@pytest.fixture(scope="module")
def elastic(slender: Robot) -> ElasticModel:
    return ElasticModel(slender)


@pytest.fixture(scope="module")
def positions(mechanism: Robot, tripod: Tripod) -> Callable[[np.ndarray], np.ndarray]:
    def at(pose: np.ndarray) -> np.ndarray:
        return mechanism.place_joints(mechanism.home.q, joint_positions(tripod, pose))[0]

    return at


def _carts(parents: list[int], masses: list[float], *, closed: bool = False) -> Robot:
    """Carts along x, each on the ground (parent 0) or on an earlier cart; the last two welded together if `closed`."""
    model = pin.Model()
    model.name = "carts"
    for index, (parent, mass) in enumerate(zip(parents, masses, strict=True)):
        joint = model.addJoint(parent, pin.JointModelPX(), pin.SE3.Identity(), f"cart{index}_joint")
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"cart{index}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    last = len(masses) - 1
    closures = [LoopClosure(f"cart{last - 1}", f"cart{last}", "6d")] if closed else []
    actuated = ["cart0_joint"] if closed else []
    return Robot(model, closures, actuated_joints=actuated, tool_frame=f"cart{last}")


def _springs(*stiffnesses: float, first: int = 0) -> list[Spring]:
    return [
        JointSpring(f"spring{first + index}", f"cart{first + index}_joint", stiffness, "N/m")
        for index, stiffness in enumerate(stiffnesses)
    ]


def test_two_carts_in_a_row() -> None:
    m1, m2, k1, k2 = 1.3, 0.4, 2.0e5, 7.0e3
    modes = natural_modes(ElasticModel(_carts([0, 1], [m1, m2]), _springs(k1, k2)), [0.0, 0.0])
    half, product = 0.5 * ((k1 + k2) / m1 + k2 / m2), k1 * k2 / (m1 * m2)
    squares = np.array([half - np.sqrt(half**2 - product), half + np.sqrt(half**2 - product)])
    np.testing.assert_allclose(modes.frequencies, np.sqrt(squares) / (2.0 * np.pi), rtol=1e-12)
    # relative coordinates: the second cart's is its position on the first
    ratios = k2 / (k2 - m2 * squares)
    np.testing.assert_allclose(modes.shapes[1] / modes.shapes[0], ratios - 1.0, rtol=1e-9)
    np.testing.assert_allclose(modes.twists[0], modes.shapes.sum(axis=0), rtol=1e-12)
    assert modes.free_motions.shape == (2, 0)


def test_free_carts_move_together_at_rest_and_vibrate_about_their_centre_of_mass() -> None:
    m1, m2, k = 3.0, 2.0, 4.0e4
    carts = Robot(_carts([0, 1], [m1, m2]).model, actuated_joints=["cart1_joint"], tool_frame="cart1")
    modes = natural_modes(ElasticModel(carts, _springs(k, first=1)), [0.2, -0.1])
    np.testing.assert_allclose(modes.frequencies, [np.sqrt(k * (m1 + m2) / (m1 * m2)) / (2.0 * np.pi)], rtol=1e-13)
    assert modes.free_motions.shape == (2, 1)
    assert modes.free_motions[1, 0] == 0.0
    np.testing.assert_allclose(modes.free_twists[1:, 0], 0.0)
    assert abs(modes.free_twists[0, 0]) > 0.0
    momentum = m1 * modes.shapes[0] + m2 * modes.shapes.sum(axis=0)
    np.testing.assert_allclose(momentum, 0.0, atol=1e-12)


def test_carts_welded_by_a_redundant_closure_share_masses_and_springs() -> None:
    carts = _carts([0, 0], [1.5, 0.5], closed=True)
    modes = natural_modes(ElasticModel(carts, _springs(3e6, 1e3)), [0.0, 0.0])
    np.testing.assert_allclose(modes.frequencies, [np.sqrt((3e6 + 1e3) / 2.0) / (2.0 * np.pi)], rtol=1e-13)


def test_an_actuated_joint_without_a_spring_is_locked() -> None:
    carts = _carts([0, 1], [1.5, 0.5])
    modes = natural_modes(ElasticModel(carts, _springs(200.0, first=1)), [0.0, 0.0])
    np.testing.assert_allclose(modes.frequencies, [20.0 / (2.0 * np.pi)], rtol=1e-13)
    assert modes.free_motions.shape == (2, 0)
    assert modes.shapes[0, 0] == 0.0


def test_a_cart_without_mass_passes_its_springs_on_in_series() -> None:
    modes = natural_modes(ElasticModel(_carts([0, 1], [0.0, 0.5]), _springs(300.0, 600.0)), [0.0, 0.0])
    np.testing.assert_allclose(modes.frequencies, [20.0 / (2.0 * np.pi)], rtol=1e-12)
    assert modes.without_mass == 1


def test_a_cantilever_with_a_body_at_its_tip_vibrates_as_structural_analysis_says() -> None:
    ei, gj, ea, length, mass = 12.0, 9.0, 2e5, 0.3, 0.7
    inertia = np.diag([2e-3, 3e-3, 1e-3])
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "base_joint")
    model.addFrame(pin.Frame("root", base, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    wrist = model.addJoint(base, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.0, 0.0, length])), "tip_joint")
    model.appendBodyToJoint(wrist, pin.Inertia(mass, np.zeros(3), inertia), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", wrist, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    mechanism = Robot(model, tool_frame="tip")  # both joints are driven, hence locked
    beam = CantileverSpring("beam", "tip_joint", (0.0, 0.0, 1.0), ei, gj, length, ea)
    modes = natural_modes(ElasticModel(mechanism, [beam]), [0.0, 0.0])
    bending = ei * np.array([[12.0 / length**3, -6.0 / length**2], [-6.0 / length**2, 4.0 / length]])
    squares = [ea / length / mass, gj / length / inertia[2, 2]]
    for moment in (inertia[0, 0], inertia[1, 1]):
        squares.extend(scipy.linalg.eigh(bending, np.diag([mass, moment]), eigvals_only=True))
    np.testing.assert_allclose(modes.frequencies, np.sqrt(np.sort(squares)) / (2.0 * np.pi), rtol=1e-10)


def _with_simple_inertias(mechanism: Robot) -> Robot:
    """The tripod with crosses as mass points and links without inertia about their own axes."""
    model = mechanism.model.copy()
    for index, name in enumerate(model.names):
        body = model.inertias[index]
        if name.startswith("universal") and name.endswith("second_joint"):
            model.inertias[index] = pin.Inertia(body.mass, body.lever, np.diag([*np.diag(body.inertia)[:2], 0.0]))
        elif name == "platform_x_joint" or name.startswith("universal"):
            model.inertias[index] = pin.Inertia(body.mass, body.lever, np.zeros((3, 3)))
    return Robot(
        model,
        mechanism.closures,
        actuated_joints=mechanism.actuated_joints,
        tool_frame=mechanism.tool_frame,
        motion_coordinates=mechanism.motion_coordinates,
        springs=mechanism.springs,
        source=mechanism.source,
    )


def _tripod_frequencies(tripod: Tripod, pose: np.ndarray) -> np.ndarray:
    """Frequencies in nine coordinates: the platform's twist at O_e, and the deflections of the three actuators.

    The strain energy is that of theory, section 4.1, before the actuators are condensed; a link is a rod whose lower
    end rides on its slider and whose upper end, beyond its spring, is E_i.
    """
    p = tripod.parameters
    links = link_vectors(tripod, pose)
    n, e = links / p.link_length, tripod.guide_directions
    rotation = placement(pose)[:3, :3]
    arms = tripod.platform_joints @ rotation.T
    stiffness, mass = np.zeros((9, 9)), np.zeros((9, 9))
    for leg in range(3):
        elongation = np.concatenate([n[leg], np.cross(arms[leg], n[leg]), np.zeros(3)])
        elongation[6 + leg] = -n[leg] @ e[leg]
        stiffness += p.link_stiffness * np.outer(elongation, elongation)
        stiffness[6 + leg, 6 + leg] += p.actuator_stiffness
        x, y, z = arms[leg]
        upper = np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]], np.zeros((3, 3))])
        lower = np.zeros((3, 9))
        lower[:, 6 + leg] = e[leg]
        turning = (np.eye(3) - np.outer(n[leg], n[leg])) @ (upper - lower) / p.link_length
        middle = lower + 0.5 * p.link_length * turning
        mass += p.slider_mass * lower.T @ lower + p.link_mass * middle.T @ middle
        mass += p.link_moments[0] * turning.T @ turning
    length = pose[2] - tripod.clamp_height
    ei, gj = p.bending_stiffness, p.torsional_stiffness
    compliance = np.diag([length**3 / (3 * ei)] * 2 + [0.0] + [length / ei] * 2 + [length / gj])
    compliance[0, 4] = compliance[4, 0] = length**2 / (2 * ei)
    compliance[1, 3] = compliance[3, 1] = -(length**2) / (2 * ei)
    held = np.zeros((3, 6))
    held[0, 0] = held[1, 1] = 1.0
    held[2, 3:] = 0.0, -np.sin(pose[0]), np.cos(pose[0])
    stiffness[:6, :6] += held.T @ np.linalg.inv(held @ compliance @ held.T) @ held
    # the first mode of a uniform cantilever moves 33/140 of it with its tip (J. Rayleigh)
    tip = p.platform_mass + p.cross_mass + 33.0 / 140.0 * (p.passive_leg_mass - p.cross_mass)
    mass[:3, :3] += np.diag([tip, tip, p.platform_mass + p.passive_leg_mass])
    mass[3:6, 3:6] += rotation @ np.diag(p.platform_moments) @ rotation.T
    return np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)) / (2.0 * np.pi)


def test_the_tripod_vibrates_as_it_does_in_nine_coordinates(
    mechanism: Robot,
    rigid_in_shear: Callable[..., Robot],
    tripod: Tripod,
    positions: Callable[..., np.ndarray],
    reachable_poses: np.ndarray,
) -> None:
    simple = ElasticModel(_with_simple_inertias(rigid_in_shear(mechanism, mass_model="lumped")))
    for pose in reachable_poses[:20]:
        modes = natural_modes(simple, positions(pose))
        np.testing.assert_allclose(modes.frequencies, _tripod_frequencies(tripod, pose), rtol=1e-8)
        assert modes.without_mass == 2  # the slope of the passive leg's tip, about both axes


def test_shapes_are_of_unit_mass_keep_the_loops_closed_and_satisfy_the_equation_of_motion(
    elastic: ElasticModel, positions: Callable[..., np.ndarray], reachable_poses: np.ndarray
) -> None:
    for pose in reachable_poses[20:25]:
        modes = natural_modes(elastic, positions(pose))
        where, shapes = modes.configuration, modes.shapes
        mass, stiffness = vibrating_mass(elastic, where), elastic.joint_stiffness(where)
        np.testing.assert_allclose(shapes.T @ mass @ shapes, np.eye(shapes.shape[1]), atol=1e-9)
        np.testing.assert_allclose(where.constraint_jacobian @ shapes, 0.0, atol=1e-9)
        squares = (2.0 * np.pi * modes.frequencies) ** 2
        # K v - omega^2 M v is a force of the closures: it does no work on any motion
        motions = np.hstack([shapes, modes.free_motions])
        left = motions.T @ (stiffness @ shapes - mass @ shapes * squares)
        assert np.abs(left).max() < 1e-8 * squares.max()
        np.testing.assert_allclose(modes.twists, where.tool_jacobian @ shapes)


def test_bodies_move_in_a_mode_as_their_places_do(
    elastic: ElasticModel, positions: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Twists of bodies at their joints, world axes, by differences of placements along a mode."""
    modes = natural_modes(elastic, positions(np.array([0.2, -0.1, 0.5])), count=2)
    mechanism, step = modes.configuration.mechanism, 1e-6
    names = [*list(mechanism.model.names)[1:], "nobody"]
    found = modes.body_twists(names)
    assert not found[:, -1].any()
    for shape, twists in zip(modes.shapes.T, found, strict=True):
        ends = []
        for sign in (1.0, -1.0):
            data = mechanism.model.createData()
            q = pin.integrate(mechanism.model, np.array(modes.configuration.q), sign * step * shape)
            pin.forwardKinematics(mechanism.model, data, q)
            ends.append([pin.SE3(place) for place in data.oMi])
        for name, twist in zip(names[:-1], twists, strict=False):
            one, other = (end[mechanism.model.getJointId(name)] for end in ends)
            turn = pin.log3(one.rotation @ other.rotation.T)
            expected = np.concatenate([one.translation - other.translation, turn]) / (2.0 * step)
            np.testing.assert_allclose(twist, expected, atol=1e-7 * np.abs(found).max())


def test_springs_and_masses_scale_the_frequencies(mechanism: Robot, elastic: ElasticModel) -> None:
    home = mechanism.home
    usual = natural_modes(elastic, home).frequencies
    stiffer = [
        JointSpring(s.name, s.joint, 4.0 * s.stiffness, s.unit)
        if isinstance(s, JointSpring)
        else AxialSpring(s.name, s.at, s.axis, 4.0 * s.stiffness)
        if isinstance(s, AxialSpring)
        else replace(s, bending_stiffness=4.0 * s.bending_stiffness, torsional_stiffness=4.0 * s.torsional_stiffness)
        for s in elastic.springs
    ]
    np.testing.assert_allclose(
        natural_modes(ElasticModel(mechanism, stiffer), home).frequencies, 2.0 * usual, rtol=1e-9
    )
    model = mechanism.model.copy()
    for index in range(1, model.njoints):
        body = model.inertias[index]
        model.inertias[index] = pin.Inertia(4.0 * body.mass, body.lever, 4.0 * np.array(body.inertia))
    heavy = Robot(model, mechanism.closures, actuated_joints=mechanism.actuated_joints, tool_frame=mechanism.tool_frame)
    heavier = [replace(s, mass=4.0 * s.mass) if isinstance(s, CantileverSpring) else s for s in elastic.springs]
    np.testing.assert_allclose(natural_modes(ElasticModel(heavy, heavier), home.q).frequencies, 0.5 * usual, rtol=1e-9)


def test_a_payload_raises_no_frequency(elastic: ElasticModel) -> None:
    home = elastic.rigid.home
    frequencies = [natural_modes(elastic, home, payloads={"O_e": mass}).frequencies for mass in (0.0, 1.0, 10.0)]
    for light, heavy in pairwise(frequencies):
        assert (heavy <= light * (1.0 + 1e-9)).all()
        assert heavy[1] < 0.9 * light[1]


def test_many_configurations_at_once_with_gaps(
    elastic: ElasticModel, positions: Callable[..., np.ndarray], reachable_poses: np.ndarray
) -> None:
    q = np.array([positions(pose) for pose in reachable_poses[:6]]).reshape(2, 3, -1)
    q[1, 1] = np.nan
    frequencies = natural_frequencies(elastic, q, count=4, on_failure="nan")
    assert frequencies.shape == (2, 3, 4)
    assert np.isnan(frequencies[1, 1]).all()
    np.testing.assert_array_equal(frequencies[0, 2], natural_modes(elastic, q[0, 2]).frequencies[:4])
    assert np.isnan(natural_frequencies(elastic, q[0, 0], count=20)).sum() == 9


def test_bad_arguments_are_refused(elastic: ElasticModel) -> None:
    home = elastic.rigid.home
    with pytest.raises(InvalidValueError, match="count"):
        natural_modes(elastic, home, count=-1)
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        natural_modes(elastic, home, payloads={"nowhere": 1.0})
    with pytest.raises(InvalidValueError, match="closed loops"):
        natural_modes(elastic, np.array(home.q) + np.eye(len(home.q))[0] * 0.01)
