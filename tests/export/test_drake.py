"""The URDF for Drake, in Drake: its ball constraints, forces of the closed form, and a simulation that stays closed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.dynamics.inverse_dynamics import inverse_dynamics
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.kinematics.robot import Robot

pytest.importorskip("pydrake")

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator as Simulation
from pydrake.systems.framework import DiagramBuilder

FileOf = Callable[[str, str], Path]
Positions = dict[str, float]
STEP = 1e-3


class Simulator:
    """A robot's committed URDF for Drake, loaded."""

    def __init__(self, path: Path, mechanism: Robot) -> None:
        builder = DiagramBuilder()
        self.plant, self.scene = AddMultibodyPlantSceneGraph(builder, STEP)
        self.plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        Parser(self.plant).AddModels(str(path))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)
        self.joints = list(mechanism.model.names)[1:]
        self.indices = [self.plant.GetJointByName(name).position_start() for name in self.joints]
        self.closures = mechanism.closures
        actuators = [self.plant.get_joint_actuator(index) for index in self.plant.GetJointActuatorIndices()]
        self.actuated = [actuator.joint().name() for actuator in actuators]
        self.efforts = [actuator.effort_limit() for actuator in actuators]
        self.actuation = self.plant.get_actuation_input_port()
        self.simulation = Simulation(self.diagram, self.root)
        self.driven = [self.plant.GetJointByName(name).position_start() for name in self.actuated]

    def place(self, positions: Mapping[str, float], rates: Mapping[str, float] | None = None) -> None:
        q, v = np.zeros((2, len(self.joints)))
        for index, name in zip(self.indices, self.joints, strict=True):
            q[index], v[index] = positions[name], rates[name] if rates else 0.0
        self.plant.SetPositions(self.context, q)
        self.plant.SetVelocities(self.context, v)

    def frames(self, loop: Any) -> list[Any]:
        return [self.plant.GetFrameByName(name) for name in (loop.frame_a, loop.frame_b)]

    def closure_error(self) -> float:
        error = 0.0
        for loop in self.closures:
            one, other = (frame.CalcPoseInWorld(self.context) for frame in self.frames(loop))
            error = max(error, np.linalg.norm(one.translation() - other.translation()))
            if loop.type == "6d":
                error = max(error, np.abs(one.rotation().matrix() - other.rotation().matrix()).max())
        return float(error)

    def state(self, make_terms: Any, positions: Mapping[str, float], rates: Mapping[str, float]) -> Any:
        self.place(positions, rates)
        plant, context, order = self.plant, self.context, self.indices
        mass = plant.CalcMassMatrix(context)[np.ix_(order, order)]
        bias = (plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context))[order]
        world = plant.world_frame()
        loops, drift = [], []
        for loop in self.closures:
            size = 3 if loop.type == "3d" else 6
            to = [(plant, context, frame, world, size) for frame in self.frames(loop)]
            jacobians, accelerations = zip(*(_frame_terms(*arguments) for arguments in to), strict=True)
            loops.append((jacobians[1] - jacobians[0])[:, order])
            drift.append(accelerations[1] - accelerations[0])
        return make_terms(self.joints, mass, bias, np.vstack(loops), np.concatenate(drift))

    def step(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.actuation.FixValue(self.context, forces)
        self.simulation.AdvanceTo(self.root.get_time() + STEP)
        q, v = self.plant.GetPositions(self.context), self.plant.GetVelocities(self.context)
        return q[self.driven], v[self.driven]


def _frame_terms(plant: Any, context: Any, frame: Any, world: Any, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian and drift of a frame, linear part first; the first `size` rows of them."""
    of_rates = JacobianWrtVariable.kV
    jacobian = plant.CalcJacobianSpatialVelocity(context, of_rates, frame, np.zeros(3), world, world)
    drift = plant.CalcBiasSpatialAcceleration(context, of_rates, frame, np.zeros(3), world, world)
    return (
        np.vstack([jacobian[3:], jacobian[:3]])[:size],
        np.concatenate([drift.translational(), drift.rotational()])[:size],
    )


@pytest.fixture
def open_robot(file_of: FileOf, load: Callable[[str], Robot]) -> Callable[[str], Simulator]:
    return lambda robot: Simulator(file_of(robot, "drake"), load(robot))


def test_the_loops_close_at_ten_poses(open_robot: Callable[[str], Simulator], ten_positions: list[Positions]) -> None:
    tripod = open_robot("pm3dof")
    for positions in ten_positions:
        tripod.place(positions)
        assert tripod.closure_error() < 1e-14


def test_every_robot_is_closed_and_touches_nothing_in_its_named_configurations(
    open_robot: Callable[[str], Simulator], robot: str, named_positions: Callable[[str], dict[str, Positions]]
) -> None:
    simulator = open_robot(robot)
    query = simulator.plant.get_geometry_query_input_port()
    for positions in named_positions(robot).values():
        simulator.place(positions)
        assert simulator.closure_error() < 1e-13
        assert not query.Eval(simulator.context).ComputePointPairPenetration()


def test_actuators_and_constraints(
    open_robot: Callable[[str], Simulator], robot: str, load: Callable[[str], Robot]
) -> None:
    """A weld takes three ball constraints."""
    simulator, mechanism = open_robot(robot), load(robot)
    assert tuple(simulator.actuated) == mechanism.actuated_joints
    assert simulator.efforts == mechanism.model.upperEffortLimit[mechanism.actuated_indices].tolist()
    assert simulator.plant.num_constraints() == sum(1 if loop.type == "3d" else 3 for loop in mechanism.closures)
    assert not simulator.plant.GetPositions(simulator.context).any()


def test_forces_are_those_of_the_closed_form(
    open_robot: Callable[[str], Simulator], assert_forces_of_the_closed_form: Callable[..., None]
) -> None:
    assert_forces_of_the_closed_form(open_robot("pm3dof"))


def test_every_robot_is_closed_and_holds_itself_with_our_forces(
    open_robot: Callable[[str], Simulator], robot: str, assert_closed_and_held: Callable[..., None]
) -> None:
    assert_closed_and_held(robot, open_robot(robot), closed=1e-13)


@pytest.mark.parametrize(
    ("robot", "gains"),
    [
        ("pm3dof", (4000.0, 20000.0, 80.0)),
        ("hexapod", (20000.0, 100000.0, 400.0)),
        ("three_rps", (100000.0, 500000.0, 4000.0)),
    ],
)
def test_a_simulation_from_home_stays_closed_and_settles_on_our_forces(
    open_robot: Callable[[str], Simulator],
    load: Callable[[str], Robot],
    settle: Callable[..., dict[str, Any]],
    robot: str,
    gains: tuple[float, float, float],
) -> None:
    """Point closures and, in the last robot, welds made of three: open by 5e-8 m at most, moving or at rest."""
    simulator, mechanism = open_robot(robot), load(robot)
    target = mechanism.configuration(mechanism.named_configurations["tilt_x"])
    end = settle(
        simulator,
        [target.joint_position(name) for name in mechanism.actuated_joints],
        time_step=STEP,
        duration=3.0,
        gains=gains,
    )
    assert end["position_error"] < 1e-8
    assert end["greatest_closure_error"] < 5e-8
    ours = holding_forces(target).actuator_forces
    np.testing.assert_allclose(end["forces"], ours, rtol=0, atol=1e-6 if robot == "pm3dof" else 5e-6)


def test_a_robot_of_ones_own(
    four_bar: Path, tmp_path: Path, actuator_forces: Callable[..., np.ndarray], terms: Any
) -> None:
    (path, *_) = export_robot(four_bar, "drake", tmp_path / "out")
    mechanism = Robot.load(four_bar)
    linkage = Simulator(path, mechanism)
    assert linkage.actuated == ["crank_joint"]
    configuration = mechanism.assemble(mechanism.home)
    positions = {name: configuration.joint_position(name) for name in linkage.joints}
    linkage.place(positions)
    assert linkage.closure_error() < 1e-12
    query = linkage.plant.get_geometry_query_input_port().Eval(linkage.context)
    assert not query.ComputePointPairPenetration()
    motion = {"rates": [2.0], "accelerations": [-3.0]}
    forces = actuator_forces(
        lambda at, rates: linkage.state(terms, at, rates),
        positions,
        actuated=["crank_joint"],
        coordinates=["crank_joint"],
        **motion,
    )
    ours = inverse_dynamics(configuration, **motion).forces.actuator_forces
    np.testing.assert_allclose(forces, ours, rtol=0, atol=1e-9)
    linkage.place(positions)
    for _ in range(100):
        _, rates = linkage.step(np.array(holding_forces(configuration).actuator_forces))
    assert linkage.closure_error() < 1e-7
    assert abs(rates).max() < 1e-4
