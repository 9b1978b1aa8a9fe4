"""Flexures: columns that buckle, frames welded on one body; against Euler, matrix analysis and frame theory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.elastic.bow import Bow
from pm3dof_pin.elastic.buckling import search_buckling
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loaded import load_deflection
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import CantileverSpring, JointLength
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

RigidTree = Callable[..., Robot]

LENGTH, EI, GJ, EA = 2.0, 300.0, 1e3, 1e8
EULER = np.pi**2 * EI / (4.0 * LENGTH**2)
DOWN = Loads({"end": [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]})


def column(rigid_tree: RigidTree, elements: int, axial_stiffness: float | None = EA) -> ElasticModel:
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, LENGTH]))
    tree = rigid_tree([("end", "universe", place, None)], tool_frame="end")
    spring = CantileverSpring("column", "end", (0, 0, 1), EI, GJ, LENGTH, axial_stiffness, elements)
    return ElasticModel(tree, [spring])


def buckling_factor(model: ElasticModel) -> float:
    search = search_buckling(model, [], DOWN)
    assert search.load is not None
    assert search.load.kind == "bifurcation"
    return search.load.factor


def test_one_spring_is_a_column(rigid_tree: RigidTree) -> None:
    """Euler's load within 1 %: that of one element of matrix structural analysis, 2.486 E I / L^2."""
    consistent = np.array([[36.0, -3.0 * LENGTH], [-3.0 * LENGTH, 4.0 * LENGTH**2]]) / (30.0 * LENGTH)
    elastic = EI / LENGTH**3 * np.array([[12.0, -6.0 * LENGTH], [-6.0 * LENGTH, 4.0 * LENGTH**2]])
    (expected, _) = sorted(np.linalg.eigvals(np.linalg.solve(consistent, elastic)))
    factor = buckling_factor(column(rigid_tree, 1))
    assert factor == pytest.approx(expected, rel=1e-4)  # it is slightly shorter when it buckles
    assert factor == pytest.approx(EULER, rel=0.01)


def test_more_elements_are_nearer_to_euler(rigid_tree: RigidTree) -> None:
    errors = [abs(buckling_factor(column(rigid_tree, count)) / EULER - 1.0) for count in (1, 2, 4)]
    assert errors[1] < 1e-3
    assert errors[2] < 1e-4
    rigid = [abs(buckling_factor(column(rigid_tree, count, None)) / EULER - 1.0) for count in (5, 10)]
    assert rigid[1] < 0.01
    assert rigid[0] / rigid[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("axial_stiffness", [EA, None])
def test_elements_change_nothing_without_loads(rigid_tree: RigidTree, axial_stiffness: float | None) -> None:
    whole, cut = (cartesian_compliance(column(rigid_tree, n, axial_stiffness), []).compliance for n in (1, 5))
    np.testing.assert_allclose(cut, whole, atol=1e-12 * np.abs(whole).max())


def test_a_beam_column_is_softer_across(rigid_tree: RigidTree) -> None:
    """Tip deflection of a cantilever under a small transverse force and an axial load P: (tan(kL) / k - L) / P."""
    (end,) = load_deflection(
        column(rigid_tree, 2),
        [],
        Loads({"end": [1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]}),
        [1.0],
        permanent=Loads({"end": [0.0, 0.0, -0.5 * EULER, 0.0, 0.0, 0.0]}),
    )
    k = np.sqrt(0.5 * EULER / EI)
    expected = (np.tan(k * LENGTH) / k - LENGTH) / (0.5 * EULER)
    assert end.displacement()[0] / 1e-3 == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("length", [0.4, 2.5])
def test_derivatives_of_the_bow(length: float) -> None:
    """Against differences of the explicit energy, with the integral of the squared slope by quadrature."""
    bow = Bow(2, np.array([0, 4, 1, 3]), 70.0, None)
    points, weights = np.polynomial.legendre.leggauss(4)
    points, weights = 0.5 * (points + 1.0), 0.5 * weights

    def energy(unknowns: np.ndarray) -> float:
        *d, span = unknowns
        shortening = 0.0
        for tip, slope in ((d[0], d[4]), (d[1], -d[3])):
            # w = a s^2 + b s^3 over s = 0 .. 1
            a, b = 3.0 * tip - slope * span, slope * span - 2.0 * tip
            slopes = (2.0 * a * points + 3.0 * b * points**2) / span
            shortening += 0.5 * span * float(weights @ slopes**2)
        c = bow.stiffness / span
        return 0.5 * c * (d[2] + shortening) ** 2 - 0.5 * c * d[2] ** 2

    rng = np.random.default_rng(3)
    at = np.append(rng.uniform(-0.2, 0.2, 6), length)
    first, second = bow.energy_derivatives(at[:-1], length)
    steps = 1e-4 * np.eye(7)
    np.testing.assert_allclose(first, [(energy(at + h) - energy(at - h)) / 2e-4 for h in steps], atol=1e-5)
    slopes = [
        [bow.energy_derivatives((at + sign * h)[:-1], (at + sign * h)[-1])[0] for sign in (1.0, -1.0)] for h in steps
    ]
    np.testing.assert_allclose(second, [(ahead - back) / 2e-4 for ahead, back in slopes], atol=1e-4)


PORTAL = """<robot name="portal">
<link name="ground"/><link name="left_top"/><link name="beam_end"/><link name="right_top"/>
<joint name="left" type="fixed"><parent link="ground"/><child link="left_top"/><origin xyz="0 0 0.4"/></joint>
<joint name="beam" type="fixed"><parent link="left_top"/><child link="beam_end"/><origin xyz="0.3 0 0"/></joint>
<joint name="right" type="fixed"><parent link="ground"/><child link="right_top"/><origin xyz="{gap} 0 0.4"/></joint>
</robot>"""
BEAM = (
    "  - {{name: {name}, type: cantilever, at: {at}, axis: {axis}, length: {length}, bending_stiffness: {ei}, "
    "torsional_stiffness: 40.0, axial_stiffness: 1.0e+11, unit: N m^2}}\n"
)


def portal(folder: Path, beam: float | None, *, springs: bool = True, gap: float = 0.3) -> Path:
    (folder / "portal.urdf").write_text(PORTAL.format(gap=gap))
    text = "closed_loop: [[beam_end, right_top]]\ntype: [6d]\ntool_frame: left_top\n"
    if springs:
        text += "springs:\n"
        for side in ("left", "right"):
            text += BEAM.format(name=f"{side}_column", at=f"{side}_top", axis=[0, 0, 1], length=0.4, ei=50.0)
        if beam is not None:
            text += BEAM.format(name="beam", at="beam_end", axis=[1, 0, 0], length=0.3, ei=beam)
    (folder / "portal.closures.yaml").write_text(text)
    return folder


@pytest.mark.parametrize("beam", [None, 3.0, 30.0, 3000.0])
def test_sway_of_a_portal(tmp_path: Path, beam: float | None) -> None:
    """24 E I / h^3 (1 + 6 g) / (4 + 6 g), g being E I over the length of the beam over that of a column."""
    model = ElasticModel.load(portal(tmp_path, beam))
    ratio = np.inf if beam is None else (beam / 0.3) / (50.0 / 0.4)
    part = 1.0 if beam is None else (1.0 + 6.0 * ratio) / (4.0 + 6.0 * ratio)
    report = cartesian_compliance(model, [])
    assert 1.0 / report.compliance[0, 0] == pytest.approx(24.0 * 50.0 / 0.4**3 * part, rel=1e-5)


def test_the_columns_of_a_portal_buckle(tmp_path: Path) -> None:
    """Out of its plane only their feet hold them: each is a separate column, pi^2 E I / 4 h^2."""
    model = ElasticModel.load(portal(tmp_path, 30.0))
    both = Loads({name: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0] for name in ("left_top", "right_top")})
    search = search_buckling(model, [], both)
    assert search.load is not None
    assert search.load.factor == pytest.approx(np.pi**2 * 50.0 / (4.0 * 0.4**2), rel=0.01)
    sideways = np.abs(search.load.mode[model.mechanism.velocity_indices(["left_column.x", "left_column.y"])])
    assert sideways[0] < 1e-6 * sideways[1]


def test_frames_on_one_body_need_springs_and_one_place(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"closed_loop\[0\]: 'beam_end' and 'right_top' are on one body"):
        Robot.load(portal(tmp_path, 30.0, springs=False))
    with pytest.raises(DescriptionError, match="coincident frames with springs between them"):
        Robot.load(portal(tmp_path, 30.0, gap=0.31))


def test_elements_that_make_no_sense() -> None:
    for elements in (0, 101):
        with pytest.raises(InvalidValueError, match="elements"):
            CantileverSpring("column", "end", (0, 0, 1), EI, GJ, LENGTH, EA, elements)
    with pytest.raises(InvalidValueError, match="a joint changes the length"):
        CantileverSpring("column", "end", (0, 0, 1), EI, GJ, JointLength("slide", 1.0), EA, 2)
