"""Receptances against the dynamic stiffness of small systems and of the described robots, written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.beam_masses import vibrating_mass
from pm3dof_pin.dynamics.damping import LOSS_FACTOR, Damping
from pm3dof_pin.dynamics.dynamic_stiffness import dynamic_stiffness, tool_receptances
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.dynamics.receptance import vibrating_system
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import AxialSpring, JointSpring, read_springs
from pm3dof_pin.exceptions import DescriptionError, FreeDirectionError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

ROBOTS = ("pm3dof", "hexapod", "linear_delta", "three_rps")
TOOL = [f"tool:{component}" for component in TOOL_COMPONENTS]
MASSES, STIFFNESS = np.array([1.3, 0.4]), np.array([2.0e5, 7.0e3])


def _carts() -> Robot:
    """Two carts in a row, the first on the ground."""
    model = pin.Model()
    model.name = "carts"
    for index, mass in enumerate(MASSES):
        joint = model.addJoint(index, pin.JointModelPX(), pin.SE3.Identity(), f"cart{index}_joint")
        model.appendBodyToJoint(joint, pin.Inertia(float(mass), np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"cart{index}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Robot(model, [], actuated_joints=["cart0_joint"], tool_frame="cart1")


def _springs(**damping: float) -> list[JointSpring]:
    return [JointSpring(f"k{i}", f"cart{i}_joint", float(k), "N/m", **damping) for i, k in enumerate(STIFFNESS)]


@pytest.mark.parametrize("kind", ["loss factor", "viscous", "servo"])
def test_two_carts_follow_their_equations(kind: str) -> None:
    losses, dampers, damping, declared = np.zeros(2), np.zeros(2), Damping(), {}
    if kind == "loss factor":
        losses, damping = np.array([0.07, LOSS_FACTOR]), Damping(loss_factors={"k0": 0.07})
    elif kind == "viscous":
        dampers, declared = np.full(2, 30.0), {"damping": 30.0}
    else:
        losses, dampers = np.array([LOSS_FACTOR, 0.0]), np.array([0.0, STIFFNESS[1] / (2.0 * np.pi * 25.0)])
        damping = Damping(bandwidths={"cart1_joint": 25.0})
    model = ElasticModel(_carts(), _springs(**declared))
    system = vibrating_system(model, np.zeros(2), damping=damping)
    rows = system.rows(["cart0:x", "tool:x"])
    frequencies = np.array([3.0, 20.0, 21.3, 64.0, 400.0])
    # absolute motions x0, x1; springs k0 to the ground and k1 between the carts
    chain = np.array([[1.0, 0.0], [-1.0, 1.0]])
    found = system.receptance(frequencies, rows, rows)
    for frequency, receptance in zip(frequencies, found, strict=True):
        w = 2.0 * np.pi * frequency
        springs = np.diag(STIFFNESS * (1.0 + 1j * losses) + 1j * w * dampers)
        expected = np.linalg.inv(chain.T @ springs @ chain - w**2 * np.diag(MASSES))
        np.testing.assert_allclose(receptance, expected, rtol=1e-11)
        shares = system.shares(float(frequency), rows[1], rows[0])
        assert shares.sum() == pytest.approx(expected[1, 0], rel=1e-11)
    # motion of the second cart relative to the base per acceleration of the base
    w = 2.0 * np.pi * 20.0
    springs = np.diag(STIFFNESS * (1.0 + 1j * losses) + 1j * w * dampers)
    expected = -np.linalg.inv(chain.T @ springs @ chain - w**2 * np.diag(MASSES)) @ MASSES
    found = system.receptance([20.0], rows, system.base_rows()[:1])[0, :, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-11)


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_follow_their_equations(name: str) -> None:
    """With Lagrange multipliers for the closures, K (1 + i eta) - omega^2 M over all joints of the tree."""
    model = ElasticModel.load(name)
    spring = model.spring_names[0]
    system = vibrating_system(model, model.rigid.home, damping=Damping(loss_factors={spring: 0.2}))
    tool = system.rows(TOOL)
    first = float(system.frequencies[0])
    frequencies = [0.0, 0.6 * first, 1.01 * first, 2.3 * first]
    found = system.receptance(frequencies, tool, tool)
    C = compliance(model, model.rigid.home)
    np.testing.assert_allclose(found[0].real, C, atol=1e-12 * np.abs(C).max())
    np.testing.assert_array_equal(found[0].imag, 0.0)
    np.testing.assert_allclose(found, found.transpose(0, 2, 1), atol=1e-12 * np.abs(found).max())

    configuration = system.configuration
    tree = model.mechanism.model
    mass = vibrating_mass(model, configuration)
    stiffness = model.joint_stiffness(configuration).astype(complex)
    for block in model.blocks:
        stiffness[:, block.indices] *= 1.0 + 1j * (0.2 if block.name == spring else LOSS_FACTOR)
    free = np.setdiff1d(np.arange(tree.nv), model.locked_indices)
    closed = scipy.linalg.null_space(configuration.constraint_jacobian[:, free], rcond=1e-9)
    jacobian = (configuration.tool_jacobian[:, free]) @ closed
    for frequency, receptance in zip(frequencies[1:], found[1:], strict=True):
        dynamic = stiffness - (2.0 * np.pi * frequency) ** 2 * mass
        expected = jacobian @ np.linalg.solve(closed.T @ dynamic[np.ix_(free, free)] @ closed, jacobian.T)
        np.testing.assert_allclose(receptance, expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["pm3dof", "linear_delta"])
def test_many_poses_have_the_extremes_of_a_fine_sweep(name: str) -> None:
    model = ElasticModel.load(name)
    robot = model.rigid
    home = robot.at(robot.home.q[None]).coordinates[0]
    reach = np.array([np.ptp(robot.range_of(c)) for c in robot.coordinates])
    values = home + 0.1 * reach * np.random.default_rng(3).uniform(-1.0, 1.0, (300, len(home)))
    poses = robot.solve(values)
    damping = Damping(loss_factors={model.spring_names[0]: 0.1})
    found = dynamic_stiffness(model, poses, damping=damping)
    few = dynamic_stiffness(model, poses.q[:3], damping=damping, engine="pinocchio")
    for field in ("minimum", "critical_frequency", "negative_real_part"):
        np.testing.assert_allclose(getattr(found, field)[:3], getattr(few, field), rtol=1e-9)
    system = vibrating_system(model, poses.q[0], damping=damping)
    tool = system.rows(TOOL)
    sweep = np.linspace(1.0, 1.2 * float(system.frequencies[5]), 100_000)
    direct = np.einsum("fii->fi", system.receptance(sweep, tool, tool))
    np.testing.assert_allclose(found.minimum[0], 1.0 / np.abs(direct).max(axis=0), rtol=1e-3)
    np.testing.assert_allclose(found.critical_frequency[0], sweep[np.abs(direct).argmax(axis=0)], rtol=1e-3)
    np.testing.assert_allclose(found.negative_real_part[0], direct.real.min(axis=0), rtol=2e-3)


def test_the_modes_that_move_the_tool_are_found_among_many() -> None:
    """At home the first 15 modes of three_rps, of its struts by themselves, do not move the tool up."""
    model = ElasticModel.load("three_rps")
    system = vibrating_system(model, model.rigid.home)
    found = dynamic_stiffness(model, model.rigid.home.q)
    tool = system.rows(["tool:z"])
    sweep = np.geomspace(5.0, 1000.0, 4000)
    direct = np.abs(system.receptance(sweep, tool, tool)[:, 0, 0])
    assert sweep[direct.argmax()] > 1.2 * system.frequencies[11]
    assert found.minimum[2] == pytest.approx(1.0 / direct.max(), rel=2e-3)
    assert found.critical_frequency[2] == pytest.approx(sweep[direct.argmax()], rel=2e-3)


def test_viscous_programs_agree_with_the_reference() -> None:
    model = ElasticModel.load("pm3dof")
    poses = model.rigid.solve(model.rigid.grid(z_e=(0.45, 0.55, 250)))
    damping = Damping(bandwidths=dict.fromkeys(model.rigid.actuated_joints, 80.0))
    found = dynamic_stiffness(model, poses, damping=damping)
    expected = dynamic_stiffness(model, poses.q[::100], damping=damping, engine="pinocchio")
    np.testing.assert_allclose(found.minimum[::100], expected.minimum, rtol=1e-9)


@pytest.mark.parametrize(
    "damping",
    [None, Damping(ratio=0.03), Damping(bandwidths={"slider1_joint": 60.0})],
    ids=["losses", "ratio", "servo"],
)
def test_receptances_of_many_poses_are_those_of_each(damping: Damping | None) -> None:
    model = ElasticModel.load("pm3dof")
    poses = model.rigid.solve(model.rigid.grid(theta_x=(-0.2, 0.3, 2), z_e=(0.45, 0.55, 250)))
    frequencies = np.array([0.0, 40.0, 155.0, 264.0, 1800.0])
    found = tool_receptances(model, poses, frequencies, damping=damping)
    assert found.shape == (2, 250, 5, 6, 6)
    for row in ((0, 0), (1, 120), (1, 249)):
        system = vibrating_system(model, poses.q[row], damping=damping)
        tool = system.rows(TOOL)
        expected = system.receptance(frequencies, tool, tool)  # one linear system for each frequency
        largest = np.abs(expected).max(axis=(1, 2), keepdims=True)
        np.testing.assert_allclose(found[row] / largest, expected / largest, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(found[..., 0, :, :].real, compliance(model, poses), rtol=0.0, atol=1e-15)


def test_modal_ratio_gives_the_peak_of_one_mode() -> None:
    robot = _carts()
    system = vibrating_system(ElasticModel(robot, _springs()[:1]), np.zeros(2), damping=Damping(ratio=0.05))
    tip = system.rows(["cart0_joint"])
    peak = system.receptance(system.frequencies, tip, tip)[0, 0, 0]
    assert 1.0 / abs(peak) == pytest.approx(2.0 * 0.05 * STIFFNESS[0], rel=1e-9)


def test_a_free_tool_is_a_free_mass_and_has_no_receptance_at_rest() -> None:
    system = vibrating_system(ElasticModel(_carts(), _springs()[:1]), np.zeros(2))
    tool = system.rows(["tool:x"])
    with pytest.raises(FreeDirectionError, match="0 Hz"):
        system.receptance([0.0], tool, tool)
    omega = 2.0 * np.pi * 7.0
    assert system.receptance([7.0], tool, tool)[0, 0, 0] == pytest.approx(-1.0 / (MASSES[1] * omega**2), rel=1e-9)


def test_modes_are_those_of_the_receptance() -> None:
    tripod = ElasticModel.load("pm3dof")
    lumped = ElasticModel(tripod.rigid, [*tripod.springs[:-1], replace(tripod.springs[-1], mass_model="lumped")])
    for model, massless in ((tripod, 0), (lumped, 3)):  # the slope of the leg's tip about both axes, and a shear
        modes = natural_modes(model, model.rigid.home)
        system = vibrating_system(model, model.rigid.home)
        np.testing.assert_allclose(system.frequencies[: len(modes.frequencies)], modes.frequencies, rtol=1e-12)
        assert modes.without_mass == np.isinf(system.frequencies).sum() == massless


@pytest.mark.parametrize(
    "damping", [Damping(bandwidths={"slider1_joint": 300.0}), Damping(ratio=0.04), Damping(ratio=0.999)]
)
def test_covariance_is_the_integral_of_the_receptance(damping: Damping) -> None:
    """Of modes that damping couples, and of others, damped a little or nearly critically."""
    model = ElasticModel.load("pm3dof")
    system = vibrating_system(model, model.rigid.home, damping=damping)
    tool = system.rows(TOOL[:3])
    edges, levels = [5.0, 100.0, 400.0], [2.0, 3.0]
    expected = np.zeros((3, 3))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    for low, high, level in zip(edges[:-1], edges[1:], levels, strict=True):
        ends = np.linspace(low, high, 4001)
        f = (0.5 * (ends[1:] + ends[:-1])[:, None] + 0.5 * np.diff(ends)[:, None] * nodes).ravel()
        G = system.receptance(f, tool, system.base_rows())
        step = (0.5 * np.diff(ends)[:, None] * weights).ravel()
        expected += level * np.einsum("fap,fbp,f->ab", G, G.conj(), step).real
    found = system.covariance(edges, levels, tool, system.base_rows())
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_springs_declare_their_damping() -> None:
    entries = [{"name": "k", "type": "joint", "joint": "cart0_joint", "stiffness": 1e5, "unit": "N/m"}]
    spring = read_springs([entries[0] | {"loss_factor": 0.3, "damping": 20.0}], "file")[0]
    losses, times = Damping().of_springs(ElasticModel(_carts(), [spring]))
    assert (losses[0], times[0]) == (0.3, 20.0 / 1e5)
    with pytest.raises(DescriptionError, match="loss_factor"):
        read_springs([entries[0] | {"loss_factor": -0.1}], "file")
    with pytest.raises(InvalidValueError, match="not negative"):
        AxialSpring("a", "tip", (0.0, 0.0, 1.0), 1e5, loss_factor=-1.0)


@pytest.mark.parametrize(
    ("damping", "message"),
    [({"loss_factors": {"nobody": 0.1}}, "nobody"), ({"bandwidths": {"platform_x_joint": 9.0}}, "platform_x_joint")],
)
def test_damping_of_unknown_parts_is_refused(damping: dict[str, dict[str, float]], message: str) -> None:
    model = ElasticModel.load("pm3dof")
    with pytest.raises(InvalidValueError, match=message):
        vibrating_system(model, model.rigid.home, damping=Damping(**damping))  # type: ignore[arg-type]
