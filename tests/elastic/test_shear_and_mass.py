"""Stubby beams and beams with mass: Timoshenko's compliance, Haringx's column, Rayleigh's and Euler's frequencies."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.robots import robots_directory
from pm3dof_pin.dynamics.beam_masses import vibrating_mass
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.dynamics.receptance import vibrating_system
from pm3dof_pin.dynamics.traced import vibrations
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.buckling import search_buckling
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import CantileverSpring, JointLength, JointSpring, MassModel, read_springs
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

RigidTree = Callable[..., Robot]

EI, GJ, EA, KGA, LENGTH = 900.0, 700.0, 6e7, 1.67e7, 0.05
UP = pin.SE3(np.eye(3), np.array([0.0, 0.0, LENGTH]))


def timoshenko(length: float, shear: float, axial: float = EA) -> np.ndarray:
    """Compliance of the tip of a cantilever along z."""
    lateral, turn = length**3 / (3.0 * EI) + length / shear, length / EI
    result = np.diag([lateral, lateral, length / axial, turn, turn, length / GJ])
    result[0, 4] = result[4, 0] = 0.5 * length**2 / EI
    result[1, 3] = result[3, 1] = -0.5 * length**2 / EI
    return result


@pytest.mark.parametrize("elements", [1, 4])
@pytest.mark.parametrize("shear", [None, KGA])
def test_a_cantilever_on_the_ground(rigid_tree: RigidTree, elements: int, shear: float | None) -> None:
    """With 50 mm of this bar shear adds 20 % to the lateral compliance; elements in series add up exactly."""
    tree = rigid_tree([("end", "universe", UP, None)], tool_frame="end")
    spring = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, EA, elements, shear)
    found = cartesian_compliance(ElasticModel(tree, [spring]), [])
    expected = timoshenko(LENGTH, shear or np.inf)
    scale = np.sqrt(expected.diagonal())
    np.testing.assert_allclose(found.compliance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-12)
    np.testing.assert_allclose(found.stiffness @ expected, np.eye(6), atol=1e-9)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_a_leg_that_a_joint_makes_longer(rigid_tree: RigidTree, engine: str) -> None:
    """Lateral compliance L^3 / (3 E I) + L / (k G A) at L = 18 and 118 mm, the drive along z in series with E A."""
    entries = [("foot", "universe", pin.SE3.Identity(), pin.JointModelPZ()), ("end", "foot", pin.SE3.Identity(), None)]
    tree = rigid_tree(entries, tool_frame="end", actuated_joints=["foot_joint"])
    springs = [
        JointSpring("drive", "foot_joint", 1e6, "N/m"),
        CantileverSpring("leg", "end", (0, 0, 1), EI, GJ, JointLength("foot_joint", 0.068), EA, shear_stiffness=KGA),
    ]
    found = compliance(ElasticModel(tree, springs), np.array([[-0.05], [0.05]]), engine=engine)  # type: ignore[arg-type]
    for matrix, length in zip(found, (0.018, 0.118), strict=True):
        expected = timoshenko(length, KGA)
        expected[2, 2] += 1e-6
        scale = np.sqrt(expected.diagonal())
        np.testing.assert_allclose(matrix / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9)


def test_a_stubby_column_buckles_earlier(rigid_tree: RigidTree) -> None:
    """J. Haringx, Philips Research Reports 3 (1948): N (1 + N / (k G A)) = N_Euler; 12 elements."""
    shear = 40.0 * EI / LENGTH**2 / 4.0
    tree = rigid_tree([("end", "universe", UP, None)], tool_frame="end")
    spring = CantileverSpring("column", "end", (0, 0, 1), EI, GJ, LENGTH, None, 12, shear)
    down = Loads({"end": [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]})
    found = search_buckling(ElasticModel(tree, [spring]), [], down).load
    assert found is not None
    euler = np.pi**2 * EI / (4.0 * LENGTH**2)
    assert found.factor == pytest.approx(0.5 * shear * (np.sqrt(1.0 + 4.0 * euler / shear) - 1.0), rel=1e-2)


ROOTS = (1.87510407, 4.69409113, 7.85475744)  # of cos root cosh root = -1


@pytest.mark.parametrize(
    ("mass_model", "elements", "tolerance"), [("lumped", 1, 0.016), ("lumped", 16, 0.003), ("consistent", 1, 0.005)]
)
def test_a_beam_vibrates_with_its_own_mass(
    rigid_tree: RigidTree, mass_model: MassModel, elements: int, tolerance: float
) -> None:
    """f = root^2 sqrt(E I / (m L^3)) / (2 pi); 33/140 of the mass at the tip is 1.5 % high, a cubic 0.48 %."""
    tree = rigid_tree([("end", "universe", UP, None)], tool_frame="end")
    mass = 0.2
    spring = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, None, elements, mass=mass, mass_model=mass_model)
    modes = natural_modes(ElasticModel(tree, [spring]), [])
    expected = ROOTS[0] ** 2 * np.sqrt(EI / (mass * LENGTH**3)) / (2.0 * np.pi)
    assert modes.frequencies[0] == pytest.approx(expected, rel=tolerance)
    assert modes.frequencies[1] == pytest.approx(modes.frequencies[0], rel=1e-9)


def test_masses_along_a_beam_give_its_higher_modes(rigid_tree: RigidTree) -> None:
    """Bending as above, torsion and elongation as quarter waves: c / (4 L); a slender bar of steel, eight elements."""
    tree = rigid_tree([("end", "universe", UP, None)], tool_frame="end")
    mass, axial = 0.2, 1e4 * EI / LENGTH**2
    spring = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, axial, 8, mass=mass)
    found = natural_modes(ElasticModel(tree, [spring]), []).frequencies
    bending = np.array(ROOTS) ** 2 * np.sqrt(EI / (mass * LENGTH**3)) / (2.0 * np.pi)
    elongation = np.sqrt(axial * LENGTH / mass) / (4.0 * LENGTH)
    torsion = np.sqrt(GJ * LENGTH / (mass * 2.0 * EI / axial)) / (4.0 * LENGTH)
    for value, tolerance in ((bending[0], 0.001), (bending[1], 0.003), (elongation, 0.002), (torsion, 0.002)):
        assert np.abs(found / value - 1.0).min() < tolerance


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("elements", [1, 2, 3])
def test_consistent_masses_are_those_of_points_along_the_bending_line(
    rigid_tree: RigidTree, elements: int, turns: bool
) -> None:
    """Kinetic energy of many points of a bar that a drive moves or turns, from its rigid and its bent motion."""
    drive = pin.JointModelRY() if turns else pin.JointModelPX()
    entries = [("slide", "universe", pin.SE3.Identity(), drive), ("end", "slide", UP, None)]
    tree = rigid_tree(entries, tool_frame="end", actuated_joints=["slide_joint"])
    middle = np.array([0.0, 0.0, 0.5 * LENGTH])
    radius = 2e-3
    rod = 0.5 * np.diag([LENGTH**2 / 12.0 + radius**2 / 4.0] * 2 + [radius**2 / 2.0])
    tree.model.appendBodyToJoint(1, pin.Inertia(0.5, middle, rod), pin.SE3.Identity())
    bar = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, None, elements, mass=0.5)
    model = ElasticModel(tree, [JointSpring("belt", "slide_joint", 1e5, "N m/rad" if turns else "N/m"), bar])
    rates = np.random.default_rng(3).normal(size=model.mechanism.model.nv)
    rates[model.mechanism.velocity_indices(["slide_joint"])] = slide = 0.7
    per = LENGTH / elements
    momentum = np.zeros(2)
    place, turn, energy = np.zeros(2), np.zeros(2), 0.0  # velocity and rate of slope in x and y at an element's clamp
    for k in range(elements):
        names = [f"bar.{motion}" if elements == 1 else f"bar.{k + 1}.{motion}" for motion in ("x", "y", "rx", "ry")]
        x, y, rx, ry = rates[model.mechanism.velocity_indices(names)]
        ends, slopes = np.array([x, y]), np.array([ry, -rx])
        s = (np.arange(4000)[:, None] + 0.5) / 4000
        cubic = ends * (3.0 * s**2 - 2.0 * s**3) + slopes * per * (s**3 - s**2)
        velocity = place + turn * per * s + cubic
        velocity[:, 0] += slide * (k + s[:, 0]) * per if turns else slide
        momentum += 0.5 / elements * velocity.mean(axis=0)
        energy += 0.25 / elements * (velocity**2).sum(axis=1).mean()
        place, turn = place + turn * per + ends, turn + slopes
    energy += 0.25 * slide**2 * radius**2 / 4.0 if turns else 0.0  # of the sections, which turn with the drive
    matrix = vibrating_mass(model, model.configuration([0.0]))
    assert 0.5 * rates @ matrix @ rates == pytest.approx(energy, rel=1e-6)
    system = vibrating_system(model, [0.0])
    np.testing.assert_allclose(system.base_rows()[:2] @ rates, -momentum, rtol=1e-6)
    if elements == 2:  # and recorded for many poses
        recorded, sound = vibrations(model, model.mechanism.model, np.array([[0.0], [0.1]]))
        assert sound.all()
        expected = natural_modes(model, [0.1], count=4).frequencies
        found = 1.0 / (2.0 * np.pi * np.sqrt(np.linalg.eigvalsh(recorded[1])[::-1][:4]))
        np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("elements", [2, 3, 5])
def test_lumps_leave_the_clamp_half_an_element_that_does_not_turn(rigid_tree: RigidTree, elements: int) -> None:
    """Of a thin bar M L^2 / 3 is all about its clamp: lumps of M / n there, half of one at the tip, are 1 / 6 n^2 more.

    The body at the clamp keeps as much, so that it is left with half an element at the clamp and turns without inertia.
    """
    entries = [("slide", "universe", pin.SE3.Identity(), pin.JointModelPX()), ("end", "slide", UP, None)]
    tree = rigid_tree(entries, tool_frame="end", actuated_joints=["slide_joint"])
    rod = 0.5 * LENGTH**2 / 12.0 * np.diag([1.0, 1.0, 0.0])
    tree.model.appendBodyToJoint(1, pin.Inertia(0.5, np.array([0.0, 0.0, 0.5 * LENGTH]), rod), pin.SE3.Identity())
    bar = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, None, elements, mass=0.5, mass_model="lumped")
    model = ElasticModel(tree, [JointSpring("belt", "slide_joint", 1e5, "N/m"), bar])
    left = model.mechanism.model.inertias[1]
    assert left.mass == pytest.approx(0.25 / elements)
    np.testing.assert_allclose(left.mass * left.lever, 0.0, atol=1e-12)
    about_clamp = left.inertia - left.mass * pin.skew(left.lever) @ pin.skew(left.lever)
    np.testing.assert_allclose(about_clamp, 0.0, atol=1e-9 * 0.5 * LENGTH**2)


def bar_on_a_slide(rigid_tree: RigidTree, mass: float) -> tuple[ElasticModel, pin.Inertia]:
    """A bar of 0.5 kg that a slide carries sideways, with 3 kg on its tip."""
    entries = [("slide", "universe", pin.SE3.Identity(), pin.JointModelPX()), ("end", "slide", UP, None)]
    tree = rigid_tree(entries, tool_frame="end", actuated_joints=["slide_joint"])
    bar = pin.Inertia(0.5, np.array([0.0, 0.0, 0.5 * LENGTH]), 0.5 * LENGTH**2 / 12.0 * np.diag([1.0, 1.0, 1e-3]))
    tree.model.appendBodyToJoint(1, bar, pin.SE3.Identity())
    spring = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, mass=mass, mass_model="lumped")
    return ElasticModel(tree, [JointSpring("belt", "slide_joint", 1e5, "N/m"), spring]), bar


def test_the_mass_belongs_to_the_body_before_the_beam(rigid_tree: RigidTree) -> None:
    """At rest nothing changes: mass, centre of mass and inertia of both pieces together are those of the body."""
    model, bar = bar_on_a_slide(rigid_tree, 0.5)
    elastic = model.mechanism.model
    data = elastic.createData()
    pin.forwardKinematics(elastic, data, np.zeros(elastic.nq))
    together = sum((data.oMi[k].act(elastic.inertias[k]) for k in range(2, elastic.njoints)), elastic.inertias[1])
    np.testing.assert_allclose(together.toDynamicParameters(), bar.toDynamicParameters(), atol=1e-15)
    tip = pin.Inertia(elastic.inertias[elastic.njoints - 1])
    assert tip.mass == pytest.approx(0.5 * 33.0 / 140.0)
    # the slide with all, and against it the tip: two masses on two springs
    k, c, a, b = 1e5, 3.0 * EI / LENGTH**3, 0.5 * 107.0 / 140.0, tip.mass
    rates = np.linalg.eigvals(np.linalg.solve(np.diag([a, b]), [[k + c, -c], [-c, c]]))
    payload_free = natural_modes(model, [0.0]).frequencies
    assert np.abs(np.sqrt(rates.min()) / (2.0 * np.pi) - payload_free).min() < 1e-6 * payload_free[0]


def test_a_beam_heavier_than_its_body_is_refused(rigid_tree: RigidTree) -> None:
    with pytest.raises(DescriptionError, match=r"the body before it has only 0.5 kg"):
        bar_on_a_slide(rigid_tree, 3.0)
    for keys in ({"shear_stiffness": -1.0}, {"mass": -0.1}, {"mass": np.inf}, {"mass_model": "none"}):
        with pytest.raises(InvalidValueError, match=next(iter(keys))):
            CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, **keys)


def test_stubby_beams_of_known_section_shear(caplog: pytest.LogCaptureFixture) -> None:
    """k G A of a round steel bar of 20 mm, twice as long as thick, from E I, G J and E A; a slender one has none."""
    young, poisson, radius = 2.1e11, 0.29, 0.01
    shear_modulus, area = young / (2.0 * (1.0 + poisson)), np.pi * radius**2
    bar = {
        **{"name": "bar", "type": "cantilever", "at": "end", "axis": [0, 0, 1], "unit": "N m^2"},
        "bending_stiffness": young * np.pi * radius**4 / 4.0,
        "torsional_stiffness": shear_modulus * np.pi * radius**4 / 2.0,
        "axial_stiffness": young * area,
    }
    (stubby,) = read_springs([bar | {"length": 0.04}], "closures.yaml")
    assert isinstance(stubby, CantileverSpring)
    coefficient = 6.0 * (1.0 + poisson) / (7.0 + 6.0 * poisson)
    assert stubby.shear_stiffness == pytest.approx(coefficient * shear_modulus * area, rel=1e-9)
    assert "0.04 m long, and shear adds 14 % to its lateral give" in caplog.text
    assert stubby.shear_share(0.02) == pytest.approx(
        3.0 * young * np.pi * radius**4 / 4.0 / (stubby.shear_stiffness * 0.02**2), rel=1e-9
    )
    thick = {key: value for key, value in bar.items() if key != "axial_stiffness"} | {"thickness": 2.0 * radius}
    (by_thickness,) = read_springs([thick | {"length": 0.04}], "closures.yaml")
    assert isinstance(by_thickness, CantileverSpring)
    assert by_thickness.shear_stiffness == pytest.approx(stubby.shear_stiffness, rel=1e-9)
    for given in ({"length": 0.4}, {"length": 0.04, "shear_stiffness": "rigid"}):
        (other,) = read_springs([bar | given], "closures.yaml")
        assert isinstance(other, CantileverSpring)
        assert other.shear_stiffness is None


def test_a_beam_is_judged_where_a_joint_makes_it_shortest(caplog: pytest.LogCaptureFixture) -> None:
    """Of 17 mm thickness it is slender at 0.2 m, 3 E I / (k G A L^2) = 0.4 %, and stubby at 0.05 m."""
    bar = {
        **{"name": "bar", "type": "cantilever", "at": "end", "axis": [0, 0, 1], "unit": "N m^2", "thickness": 0.0172},
        **{"bending_stiffness": EI, "torsional_stiffness": GJ, "length": {"joint": "slide", "at_zero": 0.2}},
    }
    for least, shears in (({}, False), ({"slide": -0.05}, False), ({"slide": -0.15}, True), ({"slide": -1.0}, False)):
        (spring,) = read_springs([bar], "closures.yaml", least)
        assert isinstance(spring, CantileverSpring)
        assert (spring.shear_stiffness is not None) == shears
    assert "spring 'bar' is 0.05 m long at its shortest" in caplog.text


def test_the_tripods_leg_shears(run: Callable[..., Any], tmp_path: Path) -> None:
    """At the top it is 18 mm long, 17.2 thick: 3 E I / (k G A L^2), k G A = 16.7 MN; rigid, the command says so."""
    (leg,) = (spring for spring in ElasticModel.load("pm3dof").springs if spring.name == "passive_leg")
    assert isinstance(leg, CantileverSpring)
    poisson = 899.6698 / 697.4185 - 1.0  # E I / (G J) of a round bar
    coefficient = 6.0 * (1.0 + poisson) / (7.0 + 6.0 * poisson)
    assert leg.shear_stiffness == pytest.approx(coefficient * 2.0 * 697.4185 / 0.0086**2, rel=1e-9)
    described = robots_directory() / "pm3dof_description" / "urdf"
    for name in ("pm3dof.urdf", "pm3dof.closures.yaml"):
        text = re.sub(r"shear_stiffness: [\d.]+", "shear_stiffness: rigid", (described / name).read_text())
        (tmp_path / name).write_text(text)
    top = run("stiffness", "--robot", str(tmp_path / "pm3dof.urdf"), "0", "0", "0.3975")
    assert "'passive_leg' is 18.3 mm long here and rigid in shear" in top.stderr
    share = 100.0 * 3.0 * 899.6698 / (1.67e7 * 0.018322**2)
    assert f"add {share:.0f} % to its lateral give" in top.stderr
    assert "shear" not in run("stiffness", "--robot", "pm3dof", "0", "0", "0.3975").stderr
