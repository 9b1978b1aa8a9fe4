"""The MJCF in MuJoCo: loops closed, forces those of the closed form, and a simulation that stays closed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.inverse_dynamics import inverse_dynamics
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.formats import export_robot, exported_files
from pm3dof_pin.export.robot_document import read_robot
from pm3dof_pin.kinematics.robot import Robot

mujoco = pytest.importorskip("mujoco")

FileOf = Callable[[str, str], Path]
Positions = dict[str, float]


class Simulator:
    """A robot's committed MJCF, loaded."""

    def __init__(self, path: Path, mechanism: Robot) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)
        self.joints = [self.model.joint(index).name for index in range(self.model.njnt)]
        self.closures = mechanism.closures
        self.actuated = mechanism.actuated_joints
        self.indices = [self.model.joint(name).qposadr[0] for name in self.actuated]

    def place(self, positions: Mapping[str, float], rates: Mapping[str, float] | None = None) -> None:
        for name, position in positions.items():
            self.data.joint(name).qpos[0] = position
            self.data.joint(name).qvel[0] = rates[name] if rates else 0.0
        mujoco.mj_forward(self.model, self.data)

    def sites(self, loop: Any) -> tuple[Any, Any]:
        return self.data.site(f"{loop.frame_a}_site"), self.data.site(f"{loop.frame_b}_site")

    def closure_error(self) -> float:
        error = 0.0
        for loop in self.closures:
            one, other = self.sites(loop)
            error = max(error, np.linalg.norm(one.xpos - other.xpos))
            if loop.type == "6d":
                error = max(error, np.abs(one.xmat - other.xmat).max())
        return float(error)

    def state(self, make_terms: Any, positions: Mapping[str, float], rates: Mapping[str, float]) -> Any:
        self.place(positions, rates)
        model, data = self.model, self.data
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        loops, drift = [], []
        velocity = np.array(data.qvel)
        for loop in self.closures:
            size = 3 if loop.type == "3d" else 6
            one, other = self.sites(loop)
            jacobian = [self._jacobian(site.id, mujoco.mj_jacSite) for site in (one, other)]
            change = [self._derivative(site) for site in (one, other)]
            loops.append((jacobian[1] - jacobian[0])[:size])
            drift.append(((change[1] - change[0]) @ velocity)[:size])
        return make_terms(self.joints, mass, np.array(data.qfrc_bias), np.vstack(loops), np.concatenate(drift))

    def _jacobian(self, index: int, function: Any) -> np.ndarray:
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        function(self.model, self.data, linear, angular, index)
        return np.vstack([linear, angular])

    def _derivative(self, site: Any) -> np.ndarray:
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        body = self.model.site_bodyid[site.id]
        mujoco.mj_jacDot(self.model, self.data, linear, angular, np.array(site.xpos), body)
        return np.vstack([linear, angular])

    def step(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        for name, force in zip(self.actuated, forces, strict=True):
            self.data.actuator(name).ctrl[0] = force
        mujoco.mj_step(self.model, self.data)
        return self.data.qpos[self.indices], self.data.qvel[self.indices]


@pytest.fixture
def open_robot(file_of: FileOf, load: Callable[[str], Robot]) -> Callable[[str], Simulator]:
    return lambda robot: Simulator(file_of(robot, "mjcf"), load(robot))


def test_the_loops_close_at_ten_poses(open_robot: Callable[[str], Simulator], ten_positions: list[Positions]) -> None:
    tripod = open_robot("pm3dof")
    for positions in ten_positions:
        tripod.place(positions)
        assert tripod.closure_error() < 1e-14
        assert tripod.data.ncon == 0


def test_keyframes_are_the_named_configurations(
    open_robot: Callable[[str], Simulator], robot: str, named_positions: Callable[[str], dict[str, Positions]]
) -> None:
    simulator = open_robot(robot)
    named = named_positions(robot)
    assert {simulator.model.key(index).name for index in range(simulator.model.nkey)} == set(named)
    for name, positions in named.items():
        key = simulator.model.key(name).id
        mujoco.mj_resetDataKeyframe(simulator.model, simulator.data, key)
        mujoco.mj_forward(simulator.model, simulator.data)
        assert simulator.closure_error() < 1e-13
        assert simulator.data.ncon == 0
        assert {joint: simulator.data.joint(joint).qpos[0] for joint in positions} == positions
    assert not simulator.model.qpos0.any()


def test_nothing_is_lost_of_the_urdf(
    open_robot: Callable[[str], Simulator], robot: str, load: Callable[[str], Robot]
) -> None:
    """Bodies are where Pinocchio has them, to all digits; shapes, limits and maximum forces are complete."""
    simulator, mechanism = open_robot(robot), load(robot)
    q = np.random.default_rng(4).uniform(-0.3, 0.3, mechanism.model.nq)
    configuration = mechanism.configuration(q)
    simulator.place({name: configuration.joint_position(name) for name in simulator.joints})
    bodies = [simulator.model.body(index).name for index in range(1, simulator.model.nbody)]
    assert set(bodies) == {frame.name for frame in mechanism.model.frames if "BODY" in str(frame.type)}
    for name in bodies:
        placement = configuration.frame_placement(name)
        np.testing.assert_allclose(simulator.data.body(name).xpos, placement.translation, rtol=0, atol=2e-15)
        np.testing.assert_allclose(simulator.data.body(name).xmat, placement.rotation.ravel(), rtol=0, atol=2e-15)
    for index in range(simulator.model.nsite):
        site = simulator.data.site(index)
        placement = configuration.frame_placement(site.name.removesuffix("_site"))
        np.testing.assert_allclose(site.xpos, placement.translation, rtol=0, atol=2e-15)
        np.testing.assert_allclose(site.xmat, placement.rotation.ravel(), rtol=0, atol=2e-15)
    assert simulator.model.body_mass.sum() == pytest.approx(
        sum(inertia.mass for inertia in mechanism.model.inertias), rel=1e-14
    )
    for index, name in enumerate(mechanism.q_names):
        limits = [mechanism.lower_limits[index], mechanism.upper_limits[index]]
        assert simulator.model.joint(name).range.tolist() == limits
    efforts = mechanism.model.upperEffortLimit[mechanism.actuated_indices]
    assert simulator.model.actuator_ctrlrange[:, 1].tolist() == efforts.tolist()
    assert (simulator.model.geom_group == 2).sum() > 20


def test_shapes_are_where_and_as_large_as_in_the_urdf(
    open_robot: Callable[[str], Simulator], robot: str, load: Callable[[str], Robot], file_of: FileOf
) -> None:
    simulator, mechanism = open_robot(robot), load(robot)
    simulator.place(dict.fromkeys(simulator.joints, 0.0))
    shapes = 0
    for link in ElementTree.parse(file_of(robot, "urdf")).getroot().iter("link"):
        for shape in [*link.iter("visual"), *link.iter("collision")]:
            origin, solid = shape.find("origin"), shape.find("geometry/*")
            assert origin is not None
            assert solid is not None
            rpy, xyz = (np.array(origin.get(key, "0 0 0").split(), dtype=float) for key in ("rpy", "xyz"))
            placement = mechanism.home.frame_placement(link.get("name", ""))
            placement = placement * pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
            geom = simulator.data.geom(shape.get("name"))
            np.testing.assert_allclose(geom.xpos, placement.translation, rtol=0, atol=1e-15)
            np.testing.assert_allclose(geom.xmat, placement.rotation.ravel(), rtol=0, atol=2e-15)
            size = simulator.model.geom(shape.get("name")).size.copy()
            if solid.tag == "box":
                assert (2.0 * size).tolist() == [float(edge) for edge in solid.get("size", "").split()]
            else:
                assert size[0] == float(solid.get("radius", "nan"))
                assert 2.0 * size[1] == float(solid.get("length", 0.0))
            shapes += 1
    assert shapes == simulator.model.ngeom


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
    """With the file's settings loops open by at most 5e-8 m, moving or at rest."""
    simulator, mechanism = open_robot(robot), load(robot)
    target = mechanism.configuration(mechanism.named_configurations["tilt_x"])
    end = settle(
        simulator,
        [target.joint_position(name) for name in mechanism.actuated_joints],
        time_step=5e-4,
        duration=3.0,
        gains=gains,
    )
    assert end["position_error"] < 1e-8
    assert end["greatest_closure_error"] < 5e-8
    ours = holding_forces(target).actuator_forces
    np.testing.assert_allclose(end["forces"], ours, rtol=0, atol=1e-6 if robot == "pm3dof" else 5e-6)


def test_with_default_settings_the_loops_would_be_tenths_of_a_millimetre_open(
    open_robot: Callable[[str], Simulator], settle: Callable[..., dict[str, Any]]
) -> None:
    tripod = open_robot("pm3dof")
    tripod.model.eq_solref[:] = [0.02, 1.0]
    tripod.model.eq_solimp[:] = [0.9, 0.95, 0.001, 0.5, 2.0]
    end = settle(tripod, np.zeros(3), time_step=5e-4, duration=1.0)
    assert end["closure_error"] > 2e-4


def test_the_closure_error_goes_with_the_square_of_the_time_constant(
    open_robot: Callable[[str], Simulator], mechanism: Robot, settle: Callable[..., dict[str, Any]]
) -> None:
    tripod = open_robot("pm3dof")
    tripod.model.opt.timestep /= 2.0
    tripod.model.eq_solref[:, 0] /= 2.0
    target = mechanism.configuration(mechanism.named_configurations["middle"])
    end = settle(
        tripod, [target.joint_position(name) for name in mechanism.actuated_joints], time_step=2.5e-4, duration=1.5
    )
    assert end["closure_error"] < 4e-9


def test_a_robot_of_ones_own(
    four_bar: Path,
    tmp_path: Path,
    actuator_forces: Callable[..., np.ndarray],
    terms: Any,
) -> None:
    """Its zero is not assembled: the sites still close the right loop, and the home keyframe is assembled."""
    (path, *meshes) = export_robot(four_bar, "mjcf", tmp_path / "out")
    assert path.name == "four_bar.xml"
    assert [mesh.name for mesh in meshes] == ["arm.obj", "arm_2.obj", "arm_3.obj", "arm.stl"]
    mechanism = Robot.load(four_bar)
    linkage = Simulator(path, mechanism)
    assert [linkage.model.mesh(index).name for index in range(linkage.model.nmesh)] == [mesh.name for mesh in meshes]
    assert linkage.model.joint("crank_joint").damping[0] == 0.01
    mujoco.mj_resetDataKeyframe(linkage.model, linkage.data, linkage.model.key("home").id)
    mujoco.mj_forward(linkage.model, linkage.data)
    assert linkage.closure_error() < 1e-12
    assert linkage.data.ncon == 0
    positions = {name: linkage.data.joint(name).qpos[0] for name in linkage.joints}
    forces = actuator_forces(
        lambda at, rates: linkage.state(terms, at, rates),
        positions,
        actuated=["crank_joint"],
        coordinates=["crank_joint"],
        rates=[2.0],
        accelerations=[-3.0],
    )
    held, _ = mechanism.place_joints(mechanism.home.q, positions)
    ours = inverse_dynamics(mechanism.configuration(held), [2.0], [-3.0]).forces.actuator_forces
    np.testing.assert_allclose(forces, ours, rtol=0, atol=1e-9)
    linkage.place(positions)
    for _ in range(200):
        linkage.step(holding_forces(mechanism.configuration(held)).actuator_forces)
    assert linkage.closure_error() < 1e-7
    assert abs(linkage.data.qvel).max() < 1e-4


def test_frames_on_two_rotated_fixed_joints_are_where_the_urdf_has_them(tmp_path: Path) -> None:
    """Rotations about different axes do not commute: their order shows in a frame after two of them."""
    fixed = (
        '<joint name="{0}" type="fixed"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}" rpy="{4}"/></joint>'
    )
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="base"/><link name="forearm"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<link name="wrist"/><link name="tool"/>'
        '<joint name="elbow" type="continuous"><parent link="base"/><child link="forearm"/><axis xyz="0 0 1"/></joint>'
        + fixed.format("to_wrist", "forearm", "wrist", "0.1 0.2 0.3", "0.4 -0.7 1.1")
        + fixed.format("to_tool", "wrist", "tool", "-0.3 0.1 0.2", "-1.2 0.5 0.3")
        + "</robot>",
        encoding="utf-8",
    )
    path.with_suffix(".closures.yaml").write_text("tool_frame: tool", encoding="utf-8")
    (file,) = export_robot(path, "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = Robot.load(path).home.tool_placement
    (site,) = [index for index in range(model.nsite) if "tool" in model.site(index).name]
    np.testing.assert_allclose(data.site_xpos[site], expected.translation, atol=1e-12)
    np.testing.assert_allclose(data.site_xmat[site].reshape(3, 3), expected.rotation, atol=1e-12)


def test_what_moves_needs_mass(four_bar: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = four_bar.read_text().replace('<mass value="0.3"/>', '<mass value="0"/>')
    four_bar.write_text(text)
    robot = read_robot(four_bar)
    for kind, tool in (("mjcf", "MuJoCo"), ("sdf", "SDFormat")):
        if robot.closures[0].type == "6d":  # it is one body with the coupler
            exported_files(robot, kind)
            assert "assigned to the massless links rocker" in caplog.text
            continue
        with pytest.raises(DescriptionError, match=f"link 'rocker': expected mass and inertia, which {tool} requires"):
            exported_files(robot, kind)
