from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot

FIVE_BAR_GUESS = [0.0, 0.5, 2.2, -1.3, 0.9, 1.3]


def test_four_bar(crank_rocker: Robot) -> None:
    mobility = instantaneous_mobility(crank_rocker.assemble([0.0, 1.0, -1.0, 1.2]))
    assert (mobility.count, mobility.tool_mobility) == (1, 1)
    assert mobility.redundant_constraints == 1, "the closure's z row is empty in a planar linkage"
    assert mobility.idle_motions.shape == (3, 0)


def test_five_bar(five_bar: Robot) -> None:
    mobility = instantaneous_mobility(five_bar.assemble(FIVE_BAR_GUESS))
    assert (mobility.count, mobility.tool_mobility, mobility.redundant_constraints) == (2, 2, 2)
    assert mobility.actuator_rank.rank == mobility.tool_rank.rank == mobility.idle_rank.rank == 2


def test_overconstrained_four_bar(welded_four_bar: Robot) -> None:
    mobility = instantaneous_mobility(welded_four_bar.assemble([1.4, -0.9, 0.8, 1.8]))
    assert (mobility.count, mobility.tool_mobility, mobility.redundant_constraints) == (1, 1, 3)
    decision = mobility.constraint_rank
    assert decision.rank == 3
    assert decision.singular_values[2] > decision.threshold > decision.singular_values[3]
    assert decision.gap > 1e12


def test_spinning_legs_are_idle(gough: Any) -> None:
    configuration = gough.mechanism.assemble(joints={"platform_joint": [0.01, 0.02, 0.1, 0.0, 0.0, 0.0, 1.0]})
    mobility = instantaneous_mobility(configuration)
    # Kutzbach: 6 degrees of freedom of the platform and 4 of each leg, less 3 for each closure
    assert mobility.count == 6 + 6 * 4 - 6 * 3
    assert (mobility.tool_mobility, mobility.redundant_constraints) == (6, 0)
    assert mobility.idle_motions.shape[1] == 6
    np.testing.assert_allclose(configuration.constraint_jacobian @ mobility.idle_motions, 0.0, atol=1e-14)
    np.testing.assert_allclose(configuration.tool_jacobian @ mobility.idle_motions, 0.0, atol=1e-14)
    for leg in range(6):
        model = gough.mechanism.model
        index = model.joints[model.getJointId(f"foot{leg}")].idx_v
        spins = mobility.idle_motions[index : index + 3]
        np.testing.assert_allclose(spins[:2], 0.0, atol=1e-14, err_msg="a leg spins about z, its own axis")
        assert np.abs(spins[2]).max() > 0.1


def test_serial_arm(ur5: Robot) -> None:
    mobility = instantaneous_mobility(ur5.configuration([0.1, -1.0, 1.2, 0.3, 0.8, 0.2]))
    assert (mobility.count, mobility.tool_mobility, mobility.redundant_constraints) == (6, 6, 0)
    assert mobility.constraint_rank.gap == np.inf


def test_a_generic_configuration_is_assembled_near_by_and_reproducible(five_bar: Robot) -> None:
    configuration = five_bar.assemble(FIVE_BAR_GUESS)
    generic = generic_configuration(configuration)
    assert generic.closure_residual < 1e-14
    moved = np.abs(generic.q - configuration.q) / five_bar.velocity_scale
    assert 1e-3 < moved.max() < 0.5  # at random, and the loops take part of it back
    np.testing.assert_array_equal(generic_configuration(configuration).q, generic.q)
    assert not np.array_equal(generic_configuration(configuration, seed=1).q, generic.q)


def test_where_nothing_closes_there_is_no_generic_configuration() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint")
    model.addFrame(pin.Frame("far", 0, 0, pin.SE3(np.eye(3), np.array([1.0, 0, 0])), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("near", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    with pytest.raises(ConvergenceError):
        generic_configuration(Robot(model, [LoopClosure("far", "near", "3d")]).home)


def test_open_loops_have_no_mobility(five_bar: Robot) -> None:
    with pytest.raises(InvalidValueError, match="closed loops"):
        instantaneous_mobility(five_bar.home)


def test_degrees_of_freedom_need_no_tool(five_bar: Robot) -> None:
    toolless = Robot(five_bar.model, five_bar.closures)
    assert instantaneous_mobility(toolless.assemble(FIVE_BAR_GUESS)).count == 2
