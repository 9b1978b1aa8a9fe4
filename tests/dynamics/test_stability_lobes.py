"""Stability lobes against closed forms and simulation in time."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.receptance import VibratingSystem, vibrating_system
from pm3dof_pin.dynamics.stability_lobes import Cutting, stability_lobes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

MASSES, STIFFNESS, RATIO = (0.4, 0.33), (5.6e6, 5.6e6), 0.035

# the example of Y. Altintas, by mode
SHAPER_STIFFNESS, SHAPER_RATIOS = np.array([2.26e8, 2.13e8]), np.array([0.012, 0.010])
SHAPER_RATES, SHAPER_CUTTING = 2.0 * np.pi * np.array([250.0, 150.0]), 1e9
SHAPER_AXES = np.array([[math.sin(angle), math.cos(angle)] for angle in np.radians([30.0, -45.0])])


def _slides(masses: tuple[float, float], stiffness: tuple[float, float], ratio: float) -> VibratingSystem:
    """A tool on two crossed slides; of the first, only what both carry is a mass."""
    model = pin.Model()
    model.name = "slides"
    first = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    second = model.addJoint(first, pin.JointModelPY(), pin.SE3.Identity(), "y")
    inertia = 1e-4 * np.eye(3)
    model.appendBodyToJoint(first, pin.Inertia(masses[0] - masses[1], np.zeros(3), inertia), pin.SE3.Identity())
    model.appendBodyToJoint(second, pin.Inertia(masses[1], np.zeros(3), inertia), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", second, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, [], actuated_joints=["x", "y"], tool_frame="tip")
    springs = [JointSpring(f"k{n}", n, k, "N/m") for n, k in zip("xy", stiffness, strict=True)]
    return vibrating_system(ElasticModel(robot, springs), np.zeros(2), damping=Damping(ratio=ratio))


def _chatters(cutting: Cutting, depth: float, speed: float) -> bool:
    """Simulate a cut in time, teeth one by one, and say whether a disturbance grows; semi-implicit Euler steps."""
    mass, k = np.array(MASSES), np.array(STIFFNESS)
    c = 2.0 * RATIO * np.sqrt(mass * k)
    teeth, tooth = max(cutting.teeth, 1), 1.0 / (speed * max(cutting.teeth, 1))
    steps = max(300, int(tooth / 1e-5))
    dt, passes = tooth / steps, 50 if tooth > 2e-3 else 100
    wave = np.zeros((steps, 2))
    u, v = np.array([1e-6, -1e-6]), np.zeros(2)
    swept = math.acos(1.0 - 2.0 * cutting.ae)
    entry, leave = (0.0, swept) if cutting.direction == "up" else (math.pi - swept, math.pi)
    sizes = []
    for _ in range(passes):
        greatest = 0.0
        for i in range(steps):
            change, force = u - wave[i], np.zeros(2)
            wave[i] = u
            if cutting.teeth:
                for j in range(teeth):
                    phi = (2.0 * math.pi / teeth * (i / steps + j)) % (2.0 * math.pi)
                    if entry <= phi <= leave:
                        s, co = math.sin(phi), math.cos(phi)
                        tangential = cutting.kc * depth * (change[0] * s + change[1] * co)
                        radial = cutting.kr * tangential
                        force += (-tangential * co - radial * s, tangential * s - radial * co)
            else:
                force[:] = -cutting.kc * depth * change[0] * np.array([cutting.kr, 1.0])
            v = v + dt * (force - c * v - k * u) / mass
            u = u + dt * v
            greatest = max(greatest, abs(u[0]), abs(u[1]))
        sizes.append(greatest)
        if greatest > 1.0 or greatest < 1e-12:
            break
    return sizes[-1] > sizes[len(sizes) // 2]


def test_turning_has_the_depth_limit_of_one_mode() -> None:
    """Twice k zeta (1 + zeta) over the cutting stiffness (J. Tlusty, 1963)."""
    system = _slides((0.4, 0.1), (5.6e6, 1e12), RATIO)
    found = stability_lobes(system, Cutting(kc=1e9, kr=0.5), [50.0])
    assert found.depth_limit == pytest.approx(2.0 * 5.6e6 * RATIO * (1.0 + RATIO) / (0.5 * 1e9), rel=1e-4)
    natural = math.sqrt(5.6e6 / 0.4) / (2.0 * math.pi)
    assert found.chatter_frequency == pytest.approx(natural * math.sqrt(1.0 + 2.0 * RATIO), rel=2e-3)


@pytest.mark.parametrize(
    "cutting",
    [Cutting(kc=6e8, kr=0.3), Cutting(kc=6e8, kr=0.3, teeth=3, ae=0.5, direction="up"), Cutting(6e8, 0.3, 4, 1.0)],
    ids=["turning", "half immersion", "slot"],
)
def test_simulation_in_time_chatters_above_the_lobes_only(cutting: Cutting) -> None:
    speeds = np.array([95.0, 130.0, 160.0, 210.0]) * 3.0 / max(cutting.teeth, 1)
    found = stability_lobes(_slides(MASSES, STIFFNESS, RATIO), cutting, speeds)
    assert (found.depths >= found.depth_limit * (1.0 - 1e-3)).all()
    for speed, depth in zip(speeds.tolist(), found.depths.tolist(), strict=True):
        assert np.isfinite(depth)
        assert not _chatters(cutting, 0.9 * depth, speed), f"{speed} 1/s"
        assert _chatters(cutting, 1.12 * depth, speed), f"{speed} 1/s"


@pytest.mark.parametrize("direction", ["up", "down"])
@pytest.mark.parametrize("ae", [0.15, 0.8])
def test_mean_forces_of_a_narrow_and_a_wide_cut(direction: Literal["up", "down"], ae: float) -> None:
    """The force of each tooth by its own angle, as in the simulation, averaged over a revolution."""
    cutting = Cutting(kc=6e8, kr=0.3, teeth=3, ae=ae, direction=direction)
    swept = math.acos(1.0 - 2.0 * ae)
    angles = np.linspace(0.0, swept, 20001) if direction == "up" else np.linspace(math.pi - swept, math.pi, 20001)
    s, c = np.sin(angles), np.cos(angles)
    forces = np.stack([[(-c - 0.3 * s) * s, (-c - 0.3 * s) * c], [(s - 0.3 * c) * s, (s - 0.3 * c) * c]])
    expected = 6e8 * 3 / (2.0 * math.pi) * np.trapezoid(forces, angles, axis=-1)
    np.testing.assert_allclose(cutting.coefficients, expected, atol=1e-7 * np.abs(expected).max())


def _shaper() -> VibratingSystem:
    """Two modes at 30 and -45 degrees from y, without coupling: the masses are those of rotors at the slides."""
    model = pin.Model()
    model.name = "shaper"
    joint = 0
    for name, (x, y) in zip(("first", "second"), SHAPER_AXES, strict=True):
        joint = model.addJoint(joint, pin.JointModelPrismaticUnaligned(x, y, 0.0), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1e-6, np.zeros(3), 1e-9 * np.eye(3)), pin.SE3.Identity())
    model.armature = SHAPER_STIFFNESS / SHAPER_RATES**2
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, [], actuated_joints=["first", "second"], tool_frame="tip")
    dampers = 2.0 * SHAPER_RATIOS * SHAPER_STIFFNESS / SHAPER_RATES
    springs = [
        JointSpring(f"k_{name}", name, float(k), "N/m", loss_factor=0.0, damping=float(c))
        for name, k, c in zip(("first", "second"), SHAPER_STIFFNESS, dampers, strict=True)
    ]
    return vibrating_system(ElasticModel(robot, springs), np.zeros(2))


def _shaping_chatters(depths: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Simulate cuts in time beside each other, the force along y by the chip's thickness; do disturbances grow?"""
    steps, passes = 160, 120
    dt = 1.0 / (speeds * steps)
    rates, ratios, part = SHAPER_RATES[:, None], SHAPER_RATIOS[:, None], SHAPER_AXES[:, 1:]
    wave = np.zeros((steps, len(speeds)))
    u, v = np.full((2, len(speeds)), 1e-6), np.zeros((2, len(speeds)))
    sizes = np.zeros((passes, len(speeds)))
    for turn in range(passes):
        for i in range(steps):
            y = (part * u).sum(axis=0)
            force = -SHAPER_CUTTING * depths * (y - wave[i])
            wave[i] = y
            v = v + dt * (rates**2 * (part * force / SHAPER_STIFFNESS[:, None] - u) - 2.0 * ratios * rates * v)
            u = u + dt * v
        sizes[turn] = np.abs(wave).max(axis=0)
    return np.asarray(sizes[-1] > sizes[passes // 2])


def test_a_published_example_with_two_modes() -> None:
    """Y. Altintas, Manufacturing Automation (2012), p. 131: a shaping process with modes at 250 and 150 Hz.

    Its diagram, drawn again by J. Li (github.com/leekunhwee/Dynamics), has minima of 7.2 mm (250 Hz) and 9.5 mm.
    """
    system = _shaper()
    cutting = Cutting(kc=1.0, kr=SHAPER_CUTTING, plane="yx")  # all of the force is along y
    speeds = np.array([2400.0, 3250.0, 4050.0, 4400.0, 5000.0, 5500.0, 7000.0, 8700.0, 10000.0, 12000.0]) / 60.0
    found = stability_lobes(system, cutting, speeds)
    assert found.depth_limit == pytest.approx(7.2e-3, abs=0.05e-3)
    assert 250.0 < found.chatter_frequency < 256.0
    assert found.depths[[0, 9]] == pytest.approx(9.5e-3, abs=0.1e-3)  # least depths of the 150 Hz lobes
    assert found.depths[[2, 5, 7]] == pytest.approx(7.2e-3, abs=0.1e-3)  # those of 250 Hz
    frequencies = np.linspace(1.0, 400.0, 200_000)
    r = 2.0 * np.pi * frequencies[:, None] / SHAPER_RATES
    parts = SHAPER_AXES[:, 1] ** 2 / SHAPER_STIFFNESS / (1.0 - r**2 + 2j * SHAPER_RATIOS * r)
    assert found.depth_limit == pytest.approx(-0.5 / (SHAPER_CUTTING * parts.sum(axis=1).real.min()), rel=2e-4)
    assert not _shaping_chatters(0.87 * found.depths, speeds).any()
    assert _shaping_chatters(1.15 * found.depths, speeds).all()


def test_a_depth_is_judged_and_slow_speeds_have_the_limit_of_all() -> None:
    system = _slides(MASSES, STIFFNESS, RATIO)
    limit = stability_lobes(system, Cutting(kc=6e8, teeth=3), [0.01]).depth_limit
    judged = stability_lobes(system, Cutting(kc=6e8, teeth=3, ap=0.99 * limit), [0.01, 100.0, 300.0])
    assert judged.is_stable is not None
    assert judged.is_stable.all()
    assert judged.depths[0] == limit


@pytest.mark.parametrize("wrong", [{"kc": 0.0}, {"kc": 1e9, "ae": 1.2}, {"kc": 1e9, "ap": -1.0}, {"kc": 1e9, "kr": -1}])
def test_impossible_cuts_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidValueError, match="cutting"):
        Cutting(**wrong)  # type: ignore[arg-type]
