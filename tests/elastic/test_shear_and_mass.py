"""Stubby beams and beams with mass: Timoshenko's compliance, Haringx's column, Rayleigh's and Euler's frequencies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.buckling import search_buckling
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import CantileverSpring, JointLength, JointSpring, read_springs
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


@pytest.mark.parametrize(("elements", "root", "tolerance"), [(1, 1.87510407, 0.016), (16, 1.87510407, 0.003)])
def test_a_beam_vibrates_with_its_own_mass(rigid_tree: RigidTree, elements: int, root: float, tolerance: float) -> None:
    """f = root^2 sqrt(E I / (m L^3)) / (2 pi), cos root cosh root = -1; 33/140 of the mass at the tip is 1.5 % high."""
    tree = rigid_tree([("end", "universe", UP, None)], tool_frame="end")
    mass = 0.2
    spring = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, EA, elements, mass=mass)
    modes = natural_modes(ElasticModel(tree, [spring]), [])
    expected = root**2 * np.sqrt(EI / (mass * LENGTH**3)) / (2.0 * np.pi)
    assert modes.frequencies[0] == pytest.approx(expected, rel=tolerance)
    assert modes.frequencies[1] == pytest.approx(modes.frequencies[0], rel=1e-9)


def bar_on_a_slide(rigid_tree: RigidTree, mass: float) -> tuple[ElasticModel, pin.Inertia]:
    """A bar of 0.5 kg that a slide carries sideways, with 3 kg on its tip."""
    entries = [("slide", "universe", pin.SE3.Identity(), pin.JointModelPX()), ("end", "slide", UP, None)]
    tree = rigid_tree(entries, tool_frame="end", actuated_joints=["slide_joint"])
    bar = pin.Inertia(0.5, np.array([0.0, 0.0, 0.5 * LENGTH]), 0.5 * LENGTH**2 / 12.0 * np.diag([1.0, 1.0, 1e-3]))
    tree.model.appendBodyToJoint(1, bar, pin.SE3.Identity())
    spring = CantileverSpring("bar", "end", (0, 0, 1), EI, GJ, LENGTH, mass=mass)
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
    for keys in ({"shear_stiffness": -1.0}, {"mass": -0.1}, {"mass": np.inf}):
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


def test_the_command_says_where_shear_would_matter(run: Callable[..., Any]) -> None:
    """At the top the tripod's leg is 18 mm long, 17.2 thick: 3 E I / (k G A L^2), k G A = 16.7 MN; not at home."""
    top = run("stiffness", "--robot", "pm3dof", "0", "0", "0.3975")
    assert "'passive_leg' is 18.3 mm long here and rigid in shear" in top.stderr
    share = 100.0 * 3.0 * 899.6698 / (1.67e7 * 0.018322**2)
    assert f"add {share:.0f} % to its lateral give" in top.stderr
    assert "shear" not in run("stiffness", "--robot", "pm3dof", "0", "0", "0.49").stderr
