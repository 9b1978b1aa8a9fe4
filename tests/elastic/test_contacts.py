"""Springs with laws: Hertz's closed forms, a mass in its play, the tripod on contacts, files and the command."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

import pm3dof_pin as pm
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.contact_catalogue import contacts
from pm3dof_pin.elastic.contact_laws import ContactLaw
from pm3dof_pin.elastic.hertz import MODULUS, POISSON, ball_between_races, in_series, point_contact
from pm3dof_pin.elastic.loaded import load_deflection
from pm3dof_pin.elastic.springs import AxialSpring, ClosureSpring, JointSpring, read_springs
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

RigidTree = Callable[..., Robot]

STEEL = MODULUS / (2.0 * (1.0 - POISSON**2))
LAWS = [
    (ContactLaw(preload=400.0), 4e8),
    (ContactLaw(preload=400.0, exponent=10.0 / 9.0), 4e8),
    (ContactLaw(preload=400.0, exponent=1.0), 4e8),
    (ContactLaw(play=1e-5, load=300.0), 1.5e8),
    (ContactLaw(play=1e-5, exponent=1.0), 1.5e8),
    (ContactLaw(doubles_at=5e-6), 9.6e7),
]


@pytest.mark.parametrize("radius", [1e-3, 1e-2])
def test_two_spheres(radius: float) -> None:
    """F = 4/3 E* sqrt(R) d^1.5 (K. Johnson, Contact Mechanics, 1985, eq. 4.23)."""
    assert point_contact((1.0 / radius, 1.0 / radius)) == pytest.approx(4.0 / 3.0 * STEEL * np.sqrt(radius), rel=1e-9)


@pytest.mark.parametrize("ratio", [1.5, 5.0, 20.0, 40.0])
def test_elliptical_contacts(ratio: float) -> None:
    """Approaches by the fits of D. Brewe and B. Hamrock (J. Lubrication Technology 99, 1977), within 3 %."""
    rx, ry = 2e-3, 2e-3 * ratio
    axes = 1.0339 * ratio**0.6360
    second, first = 1.0003 + 0.5968 / ratio, 1.5277 + 0.6023 * np.log(ratio)
    radius = 1.0 / (1.0 / rx + 1.0 / ry)
    expected = np.pi * axes * 2.0 * STEEL * np.sqrt(radius * second / (4.5 * first**3))
    approach = point_contact((1.0 / rx, 1.0 / ry)) ** (-2.0 / 3.0)
    assert approach == pytest.approx(expected ** (-2.0 / 3.0), rel=0.03)


@pytest.mark.parametrize(("law", "stiffness"), LAWS)
def test_the_tangent_is_the_derivative_of_the_force(law: ContactLaw, stiffness: float) -> None:
    """In three directions at once, before and after a contact opens or closes."""
    for amount in (1e-6, 2.1e-6, 1.3e-5):
        d = amount * np.array([0.6, 0.0, -0.8])
        tangent = law.derivatives(stiffness, d)[1]
        step = 1e-10
        columns = [
            (law.derivatives(stiffness, d + step * axis)[0] - law.derivatives(stiffness, d - step * axis)[0])
            / (2.0 * step)
            for axis in np.eye(3)
        ]
        np.testing.assert_allclose(np.stack(columns, axis=1), tangent, rtol=1e-5, atol=1e-5 * stiffness)


@pytest.mark.parametrize("exponent", [1.5, 10.0 / 9.0, 1.0])
def test_a_preload_is_gone_at_its_multiple(exponent: float) -> None:
    """Two contacts of F = C d^n under P: the second one opens at the force 2^n P, 2.83 P for balls."""
    law, stiffness = ContactLaw(preload=500.0, exponent=exponent), 3e8
    opening = law.opens_at(stiffness)
    assert law.force(stiffness, opening)[0] == pytest.approx(2.0**exponent * 500.0)
    coefficient = 500.0 / opening**exponent
    beyond = 1.7 * opening
    assert law.force(stiffness, beyond)[0] == pytest.approx(coefficient * (opening + beyond) ** exponent)
    assert [law.state(stiffness, d) for d in (0.5 * opening, beyond)] == ["preloaded", "one-sided"]
    assert law.force(stiffness, 0.0) == (0.0, pytest.approx(stiffness))


def slide(rigid_tree: RigidTree) -> Robot:
    return rigid_tree([("tip", "universe", pin.SE3.Identity(), pin.JointModelPZ())], tool_frame="tip")


@pytest.mark.parametrize(("law", "stiffness"), LAWS)
@pytest.mark.parametrize("force", [-900.0, 40.0])
def test_a_slide_on_one_contact(rigid_tree: RigidTree, law: ContactLaw, stiffness: float, force: float) -> None:
    """The deflection solves law(d) = F, found by bisection; a play closes on the side to which the force points."""
    model = pm.ElasticModel(slide(rigid_tree), [JointSpring("screw", "tip_joint", stiffness, "N/m", law=law)])
    found = pm.loaded_equilibrium(model, [0.0], pm.Loads({"tip": [0.0, 0.0, force, 0.0, 0.0, 0.0]}))
    expected = brentq(lambda d: law.force(stiffness, d)[0] - abs(force), 0.0, 1e-3, xtol=1e-16)
    assert found.displacement()[2] == pytest.approx(np.sign(force) * expected, rel=1e-6)
    assert found.tangent_compliance()[2, 2] == pytest.approx(1.0 / law.force(stiffness, expected)[1], rel=1e-5)


def test_a_play_that_nothing_closes_is_open(rigid_tree: RigidTree) -> None:
    law = ContactLaw(play=1e-5, exponent=1.0)
    model = pm.ElasticModel(slide(rigid_tree), [JointSpring("screw", "tip_joint", 1e8, "N/m", law=law)])
    found = pm.loaded_equilibrium(model, [0.0], pm.Loads())
    assert law.state(1e8, abs(float(found.spring_deflections[0]))) == "open"


def test_a_ball_hangs_in_its_socket(rigid_tree: RigidTree) -> None:
    """Radial play: the ball moves by c + r0 (F / load)^(2/3) in the direction of the force, whatever that is."""
    tree = rigid_tree(
        [
            ("x", "universe", pin.SE3.Identity(), pin.JointModelPX()),
            ("y", "x", pin.SE3.Identity(), pin.JointModelPY()),
            ("arm", "y", pin.SE3.Identity(), pin.JointModelPZ()),
            ("seat", "universe", pin.SE3.Identity(), None),
        ],
        tool_frame="arm",
        closures=[LoopClosure("seat", "arm", "3d")],
    )
    law = ContactLaw(play=2e-5, load=100.0)
    model = pm.ElasticModel(tree, [ClosureSpring("socket", 0, 5e7 * np.eye(3), law=law)])
    force = 250.0 * np.array([2.0, -1.0, 2.0]) / 3.0
    found = pm.loaded_equilibrium(model, [0.0, 0.0, 0.0], pm.Loads({"arm": [*force, 0.0, 0.0, 0.0]}))
    depth = 1.5 * 100.0 / 5e7 * 2.5 ** (2.0 / 3.0)
    np.testing.assert_allclose(found.displacement()[:3], (2e-5 + depth) * force / 250.0, rtol=1e-4)


def _on_contacts(law: ContactLaw, stiffness: float) -> pm.ElasticModel:
    robot = pm.load("pm3dof")
    springs = pm.ElasticModel(robot).springs
    return pm.ElasticModel(
        robot, [replace(s, stiffness=stiffness, law=law) if isinstance(s, JointSpring) else s for s in springs]
    )


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_where_gravity_closes_the_play_of_the_screws(tilt: float) -> None:
    """Each screw bears the holding force of rigid statics, on the side to which the weight presses it."""
    law, stiffness = ContactLaw(play=1e-5, load=300.0), 1.5e8
    model = _on_contacts(law, stiffness)
    configuration = model.rigid.solve([tilt, 0.0, 0.5]).configuration()
    found = pm.loaded_equilibrium(model, configuration, pm.Loads(own_weight=True))
    held = np.asarray(holding_forces(configuration).actuator_forces)
    rows = [rows for block, rows in zip(model.blocks, model.spring_slices, strict=True) if block.law is not None]
    deflections = np.array([found.spring_deflections[r][0] for r in rows])
    forces = np.array([np.sign(d) * law.force(stiffness, abs(d))[0] for d in deflections])
    np.testing.assert_allclose(forces, -held, rtol=2e-3)
    assert {law.state(stiffness, abs(d)) for d in deflections} == {"closed"}


def test_tangent_compliance_on_preloaded_contacts_by_differences() -> None:
    """Beyond the preload of two screws; central differences of equilibria."""
    model, q = _on_contacts(ContactLaw(preload=100.0), 3.9e8), pm.load("pm3dof").home.q
    base = np.array([200.0, 0.0, -600.0, 0.0, 0.0, 0.0])

    def at(wrench: np.ndarray) -> Any:
        return pm.loaded_equilibrium(model, q, pm.Loads({"O_e": wrench}))

    tangent = at(base).tangent_compliance()
    step = 2.0 * np.eye(6)[2]
    difference = (at(base + step).displacement() - at(base - step).displacement()) / 4.0
    assert difference[2] == pytest.approx(tangent[2, 2], rel=1e-4)
    assert tangent[2, 2] > 1.05 / model.blocks[0].coefficients[0, 0] / 3.0


def test_maps_linearise_at_the_preload() -> None:
    """With the stiffness of the description, compliance is that of a linear spring, law or not."""
    model = _on_contacts(ContactLaw(preload=100.0), 9.595e7)
    poses = model.rigid.solve(model.rigid.grid(z_e=(0.42, 0.55, 4)))
    np.testing.assert_array_equal(pm.compliance(model, poses), pm.compliance(model.rigid, poses))


def test_a_load_path_through_the_play() -> None:
    model = _on_contacts(ContactLaw(play=1e-5, load=300.0), 1.5e8)
    down = pm.Loads({"O_e": [0.0, 0.0, -500.0, 0.0, 0.0, 0.0]})
    path = load_deflection(model, model.rigid.home, down, [0.2, 1.0])
    direct = pm.loaded_equilibrium(model, model.rigid.home, down)
    np.testing.assert_allclose(path[-1].displacement(), direct.displacement(), atol=1e-12)


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        ({}, "one of preload, play, doubles_at"),
        ({"preload": 100.0, "play": 1e-5}, "one of preload, play, doubles_at"),
        ({"play": 1e-5}, "force"),
        ({"preload": -1.0}, "> 0"),
        ({"preload": 1.0, "exponent": 0.5}, ">= 1"),
        ({"preload": 1.0, "stiff": 0.5}, "unknown key"),
    ],
)
def test_laws_that_are_refused(law: dict[str, float], expected: str) -> None:
    entry = {
        "name": "nut",
        "type": "axial",
        "at": "tip",
        "axis": [0, 0, 1],
        "stiffness": 1e8,
        "unit": "N/m",
        "law": law,
    }
    with pytest.raises(DescriptionError, match=r"springs\[0\] 'nut'") as raised:
        read_springs([entry], "closures.yaml")
    assert expected in str(raised.value)


def test_laws_need_springs_that_have_one_direction_or_are_alike_in_all() -> None:
    law = ContactLaw(preload=100.0)
    with pytest.raises(InvalidValueError, match="prismatic"):
        JointSpring("hinge", "joint", 1e3, "N m/rad", law=law)
    with pytest.raises(InvalidValueError, match="alike"):
        ClosureSpring("ball", 0, np.diag([1e8, 1e8, 2e8]), law=law)


def test_contacts_of_the_catalogue() -> None:
    """By name in a file; their stiffness rises with the cube root of the preload, as of all contacts of balls."""
    for name, contact in contacts().items():
        base = {"name": "nut", "type": "axial", "at": "tip", "axis": [0, 0, 1], "contact": name}
        (usual,), (harder,) = (
            read_springs([base | more], "f.yaml") for more in ({}, {"preload": 8.0 * contact.preload})
        )
        assert isinstance(usual, AxialSpring)
        assert isinstance(harder, AxialSpring)
        assert harder.stiffness == pytest.approx(2.0 * usual.stiffness)
        assert usual.law == ContactLaw(preload=contact.preload)
        assert 1e7 < usual.stiffness < 2e9
        assert contact.source
    with pytest.raises(DescriptionError, match=r"contact.*expected one of ball_screw"):
        read_springs([base | {"contact": "glue"}], "f.yaml")
    with pytest.raises(DescriptionError, match="none beside a contact"):
        read_springs([base | {"stiffness": 1e8}], "f.yaml")


def test_a_screw_bears_on_the_normals_of_its_grooves() -> None:
    """Force of all balls at a small axial displacement, along the normals of a groove that runs up the helix."""
    ball, diameter, lead, angle = 0.003175, 0.0165, 0.005, np.radians(45.0)
    turns = np.linspace(0.0, 2.0 * np.pi * 3.0, 20001)
    groove = np.stack([0.5 * diameter * np.cos(turns), 0.5 * diameter * np.sin(turns), lead / (2.0 * np.pi) * turns], 1)
    count = np.linalg.norm(np.diff(groove, axis=0), axis=1).sum() / ball
    along = (groove[1] - groove[0]) / np.linalg.norm(groove[1] - groove[0])
    across = np.cross(along, [1.0, 0.0, 0.0])
    normal = np.cos(angle) * np.array([1.0, 0.0, 0.0]) + np.sin(angle) * across / np.linalg.norm(across)
    radius = 0.5 * (diameter - ball * np.cos(angle)) / np.cos(angle)  # of curvature, in the plane of the contact
    curvatures = (1.0 / radius, -1.0 / (radius + ball))
    one = ball_between_races(ball, 0.53, *curvatures)
    force = count * one * abs(normal[2]) ** 1.5 * abs(normal[2])  # at a displacement of 1
    assert contacts()["ball_screw_16x5"].coefficient == pytest.approx(force, rel=1e-4)


def test_a_preloaded_ball_on_balls_all_around() -> None:
    """Their forces add up to the preload over each hemisphere, their stiffness along one axis to the joint's."""
    ball, diameter, count, preload = 0.0015875, 0.020, 200, 100.0
    heights = 1.0 - (2.0 * np.arange(20000) + 1.0) / 20000  # evenly over a sphere, by Archimedes
    one = in_series(
        point_contact((2.0 / ball + 2.0 / diameter,) * 2),
        point_contact((2.0 / ball - 2.0 / (diameter + 2.0 * ball),) * 2),
    )
    force = preload / (count * 0.5 * np.abs(heights).mean())
    stiffness = count * (heights**2).mean() * 1.5 * one ** (2.0 / 3.0) * force ** (1.0 / 3.0)
    found, _ = contacts()["spherical_joint_rolling_20"].spring()
    assert found == pytest.approx(0.8 * stiffness, rel=1e-6)


def test_the_command(run: Callable[..., Any], tmp_path: Path) -> None:
    """A weight on a slide with play, by file: c + weight / k of the closed contact, and one pose per row."""
    (tmp_path / "slide.urdf").write_text(
        '<robot name="slide"><link name="base"/><link name="tip"><inertial><mass value="10"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="z" type="prismatic"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1e3" velocity="1"/></joint></robot>'
    )
    (tmp_path / "slide.closures.yaml").write_text(
        "closed_loop: []\ntype: []\nname_mot: [z]\ntool_frame: tip\nsprings:\n"
        "  - {name: screw, type: joint, joint: z, stiffness: 1.0e+8, unit: N/m, law: {play: 1.0e-5, exponent: 1.0}}\n"
        "  - {name: side, type: axial, at: tip, axis: [1, 0, 0], contact: guide_carriage_20}\n"
    )
    words = ("equilibrium", "--robot", str(tmp_path / "slide.urdf"), "--json")
    found = json.loads(run(*words, "0.1").stdout)
    screw, side = found["contacts"]
    assert screw["state"] == "closed"
    assert screw["force_N"] == pytest.approx(-98.1, rel=1e-3)
    assert found["displacement"]["z"] == pytest.approx(-(1e-5 + 98.1 / 1e8), rel=1e-3)
    assert found["displacement_of_linear_springs"]["z"] == pytest.approx(-98.1 / 1e8, rel=1e-3)
    assert (side["state"], side["force_N"]) == ("preloaded", pytest.approx(0.0, abs=1e-6))
    light = json.loads(run(*words, "0.1", "--weightless").stdout)
    assert light["contacts"][0]["state"] == "open"
    (tmp_path / "poses.csv").write_text("z_m\n0.1\n0.2\n")
    columns = json.loads(run(*words, "--poses", str(tmp_path / "poses.csv")).stdout)["columns"]
    assert columns["screw_state"] == ["closed", "closed"]
    np.testing.assert_allclose(columns["d_z_m"], found["displacement"]["z"], rtol=1e-9)
