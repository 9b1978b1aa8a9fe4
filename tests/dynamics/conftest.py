"""Mechanisms with masses, and their kinematics in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration


@dataclass(frozen=True)
class Link:
    """A link of a planar linkage: length, mass, centre of mass along and across it, inertia about that."""

    length: float
    mass: float
    along: float
    across: float
    inertia: float


CRANK = Link(0.2, 0.7, 0.08, 0.03, 2.1e-3)
COUPLER = Link(0.5, 1.1, 0.31, -0.05, 9.0e-3)
ROCKER = Link(0.4, 0.9, 0.17, 0.02, 6.0e-3)
GROUND = 0.6
GRAVITY = 9.81


class FourBar:
    """A four-bar in the vertical plane x, z, its joints turning about -y: in closed form, for any crank angle.

    The crank angle may be complex: the imaginary part over a tiny step is then the exact derivative.
    """

    def directions(self, crank: complex) -> NDArray[np.complex128]:
        """Unit vectors along crank, coupler and rocker, as x + z in two columns, shape=(3, 2)."""
        along = np.array([np.cos(crank), np.sin(crank)])
        pivot = np.array([GROUND, 0.0]) - CRANK.length * along  # rocker's pivot from the crank's tip
        square = pivot @ pivot
        reach = (square + COUPLER.length**2 - ROCKER.length**2) / (2.0 * square)
        height = np.sqrt(COUPLER.length**2 / square - reach**2)
        to_tip = reach * pivot + height * np.array([-pivot[1], pivot[0]])
        return np.array([along, to_tip / COUPLER.length, (to_tip - pivot) / ROCKER.length])

    def angles(self, crank: float) -> NDArray[np.float64]:
        """Angles of the three links relative to the ground, shape=(3,) [rad]."""
        directions = self.directions(crank).real
        return np.arctan2(directions[:, 1], directions[:, 0])

    def centres(self, crank: complex) -> NDArray[np.complex128]:
        """Centres of mass, shape=(3, 2) [m]."""
        directions = self.directions(crank)
        starts = np.array([[0.0, 0.0], CRANK.length * directions[0], [GROUND, 0.0]])
        normals = np.stack([-directions[:, 1], directions[:, 0]], axis=1)
        along, across = np.array([[link.along, link.across] for link in (CRANK, COUPLER, ROCKER)]).T[..., None]
        return starts + along * directions + across * normals

    def potential_slope(self, crank: float) -> float:
        """dV/d(crank) of the weights [N m]."""
        heights = self.centres(crank + 1e-30j)[:, 1].imag / 1e-30
        return GRAVITY * sum(link.mass * slope for link, slope in zip((CRANK, COUPLER, ROCKER), heights, strict=True))

    def speeds(self, crank: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Velocities of the centres of mass, shape=(3, 2), and the links' rates, shape=(3,), for a crank rate of 1."""
        directions = self.directions(crank + 1e-30j)
        turned = directions.imag / 1e-30
        rates = directions[:, 0].real * turned[:, 1] - directions[:, 1].real * turned[:, 0]
        return self.centres(crank + 1e-30j).imag / 1e-30, rates

    def inertia(self, crank: float) -> float:
        """Twice the kinetic energy for a crank rate of 1 [kg m^2]."""
        velocities, rates = self.speeds(crank)
        links = zip((CRANK, COUPLER, ROCKER), velocities, rates, strict=True)
        return float(sum(link.mass * v @ v + link.inertia * rate**2 for link, v, rate in links))

    def torque(self, crank: float, rate: float, acceleration: float) -> float:
        """Lagrange's equation of the crank [N m]."""
        slope = (self.inertia(crank + 1e-5) - self.inertia(crank - 1e-5)) / 2e-5
        return self.inertia(crank) * acceleration + 0.5 * slope * rate**2 + self.potential_slope(crank)


def _joint(model: pin.Model, parent: int, x: float, link: Link, name: str) -> int:
    """Add a link that turns about -y of the world; its own axes are x along it, y its axis, z across it downwards."""
    flipped = np.diag([1.0, -1.0, -1.0]) if parent == 0 else np.eye(3)
    joint = model.addJoint(parent, pin.JointModelRY(), pin.SE3(flipped, np.array([x, 0.0, 0.0])), f"{name}_joint")
    lever = np.array([link.along, 0.0, -link.across])
    inertia = np.diag([0.3 * link.inertia, link.inertia, 0.8 * link.inertia])
    model.appendBodyToJoint(joint, pin.Inertia(link.mass, lever, inertia), pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([link.length, 0.0, 0.0]))
    model.addFrame(pin.Frame(f"{name}_tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    return joint


@pytest.fixture(scope="session")
def four_bar() -> FourBar:
    """The linkage in closed form."""
    return FourBar()


@pytest.fixture(scope="session")
def make_four_bar() -> Callable[..., Robot]:
    """The same linkage as a mechanism, crank and rocker on the ground, closed where coupler and rocker meet."""

    def make(*driven: str, closure: str = "3d") -> Robot:
        model = pin.Model()
        model.name = "four_bar"
        crank = _joint(model, 0, 0.0, CRANK, "crank")
        _joint(model, crank, CRANK.length, COUPLER, "coupler")
        rocker = _joint(model, 0, GROUND, ROCKER, "rocker")
        end = "rocker_tip"
        if closure == "6d":  # the pin between coupler and rocker is then a joint of the tree
            pin_joint = model.addJoint(
                rocker, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([ROCKER.length, 0.0, 0.0])), "pin_joint"
            )
            end = "pin"
            model.addFrame(pin.Frame(end, pin_joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        first, second, third = FourBar().angles(1.0)
        angles = {"crank_joint": first, "coupler_joint": second - first, "rocker_joint": third}
        angles["pin_joint"] = second - third
        model.referenceConfigurations["home"] = np.array([angles[name] for name in list(model.names)[1:]])
        return Robot(
            model,
            [LoopClosure("coupler_tip", end, closure)],
            actuated_joints=driven or ("crank_joint",),
            tool_frame="coupler_tip",
        )

    return make


@pytest.fixture(scope="session")
def place_four_bar(four_bar: FourBar) -> Callable[[Robot, float], Configuration]:
    """Put the mechanism at a crank angle, by the closed form."""

    def place(mechanism: Robot, crank: float) -> Configuration:
        first, second, third = four_bar.angles(crank)
        angles = {"crank_joint": first, "coupler_joint": second - first, "rocker_joint": third}
        angles["pin_joint"] = second - third
        q = np.zeros(mechanism.model.nq)
        for name in list(mechanism.model.names)[1:]:
            mechanism.single_joint(name).set_coordinate(q, angles[name])
        configuration = mechanism.configuration(q)
        assert configuration.closure_residual < 1e-14
        return configuration

    return place


@dataclass(frozen=True)
class SpatialCrank:
    """A crank that drives a slider through a link with ball joints at both ends, which can spin about its own axis."""

    mechanism: Robot
    configuration: Configuration


@pytest.fixture(scope="session")
def spatial_crank() -> SpatialCrank:
    """Crank 0.1 about x, link 0.4 of a round bar, slider along x off the crank's plane."""
    model = pin.Model()
    model.name = "spatial_crank"
    crank = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "crank_joint")
    model.appendBodyToJoint(crank, pin.Inertia(0.5, np.array([0.0, 0.03, 0.01]), 1e-3 * np.eye(3)), pin.SE3.Identity())
    ball = pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.0]))
    link = model.addJoint(crank, pin.JointModelSpherical(), ball, "ball_joint")
    bar = pin.Inertia(0.8, np.array([0.2, 0.0, 0.0]), np.diag([4e-3, 1.2e-2, 1.2e-2]))
    model.appendBodyToJoint(link, bar, pin.SE3.Identity())
    slider = model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([0.0, -0.05, 0.07])), "slider_joint")
    model.appendBodyToJoint(slider, pin.Inertia(0.6, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", link, 0, tip, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("slider", slider, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    mechanism = Robot(model, [LoopClosure("tip", "slider", "3d")], actuated_joints=["crank_joint"], tool_frame="slider")
    guess = pin.neutral(model)
    guess[mechanism.single_joint("slider_joint").q_index] = 0.35
    return SpatialCrank(mechanism, mechanism.assemble(guess, joints={"crank_joint": 0.4}))


@pytest.fixture(scope="session")
def ur5() -> Robot:
    """A serial arm with six joints, from example-robot-data."""
    import example_robot_data

    return Robot(example_robot_data.load("ur5").model, tool_frame="tool0")
