"""Reading springs: every type, and the errors of invalid ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import (
    AxialSpring,
    BeamSpring,
    CantileverSpring,
    ClosureSpring,
    JointLength,
    JointSpring,
    read_springs,
)
from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError, InvalidValueError, JointNotFoundError
from pm3dof_pin.kinematics.robot import Robot

FILE = Path("robot.closures.yaml")
JOINT = {"name": "a", "type": "joint", "joint": "slider1_joint", "stiffness": 9.6e7, "unit": "N/m"}
AXIAL = {"name": "b", "type": "axial", "at": "link1_tip", "axis": [0, 0, 2], "stiffness": 1e10, "unit": "N/m"}
CANTILEVER = {
    "name": "c",
    "type": "cantilever",
    "at": "platform_x_joint",
    "axis": [0, 0, 1],
    "bending_stiffness": 900.0,
    "torsional_stiffness": 700,
    "unit": "N m^2",
    "length": {"joint": "passive_slider_joint", "at_zero": 0.11},
}
BEAM = {"name": "d", "type": "beam", "at": "E1", "matrix": np.diag([1.0, 2, 3, 4, 5, 6]).tolist()}
CLOSURE = {"name": "e", "type": "closure", "closure": 0, "matrix": np.diag([1.0, 2, 3]).tolist()}


def test_every_type() -> None:
    joint, axial, cantilever, beam, closure = read_springs([JOINT, AXIAL, CANTILEVER, BEAM, CLOSURE], FILE)
    assert joint == JointSpring("a", "slider1_joint", 9.6e7, "N/m")
    assert axial == AxialSpring("b", "link1_tip", (0.0, 0.0, 1.0), 1e10)
    length = JointLength("passive_slider_joint", 0.11)
    assert cantilever == CantileverSpring("c", "platform_x_joint", (0.0, 0.0, 1.0), 900.0, 700.0, length)
    assert isinstance(beam, BeamSpring)
    assert isinstance(closure, ClosureSpring)
    np.testing.assert_array_equal(beam.matrix, np.diag([1.0, 2, 3, 4, 5, 6]))
    np.testing.assert_array_equal(closure.matrix, np.diag([1.0, 2, 3]))
    assert not beam.matrix.flags.writeable
    assert read_springs([], FILE) == ()


def test_a_number_with_an_exponent_that_yaml_takes_for_text() -> None:
    (spring,) = read_springs([JOINT | {"stiffness": "9.6e7"}], FILE)
    assert spring == JointSpring("a", "slider1_joint", 9.6e7, "N/m")


def test_a_constant_length_and_an_axial_stiffness() -> None:
    (spring,) = read_springs([CANTILEVER | {"length": 0.2, "axial_stiffness": 5e7}], FILE)
    assert isinstance(spring, CantileverSpring)
    assert (spring.length, spring.axial_stiffness) == (0.2, 5e7)


SYMMETRIC = np.diag([4.0, 5, 6])
WRONG: list[tuple[str, dict[str, Any], str]] = [
    ("no name", {"type": "joint"}, "springs[0].name"),
    ("empty name", JOINT | {"name": ""}, "springs[0].name"),
    ("no type", {"name": "a"}, "type"),
    ("unknown type", JOINT | {"type": "rubber"}, "type"),
    ("a list as type", JOINT | {"type": ["joint"]}, "type"),
    ("unknown key", JOINT | {"colour": "red"}, "colour"),
    ("missing key", {key: JOINT[key] for key in JOINT if key != "stiffness"}, "stiffness"),
    ("missing unit", {key: JOINT[key] for key in JOINT if key != "unit"}, "unit"),
    ("wrong unit", JOINT | {"unit": "N/mm"}, "unit"),
    ("wrong unit of a link", AXIAL | {"unit": "N m/rad"}, "unit"),
    ("wrong unit of a cantilever", CANTILEVER | {"unit": "N/m"}, "unit"),
    ("negative", JOINT | {"stiffness": -1.0}, "stiffness"),
    ("zero", JOINT | {"stiffness": 0}, "stiffness"),
    ("not a number", JOINT | {"stiffness": float("nan")}, "stiffness"),
    ("infinite", JOINT | {"stiffness": float("inf")}, "stiffness"),
    ("text", JOINT | {"stiffness": "stiff"}, "stiffness"),
    ("a truth value", JOINT | {"stiffness": True}, "stiffness"),
    ("no joint", JOINT | {"joint": None}, "joint"),
    ("no axis", AXIAL | {"axis": [0, 0, 0]}, "axis"),
    ("an axis of two numbers", AXIAL | {"axis": [0, 1]}, "axis"),
    ("an axis that is not finite", AXIAL | {"axis": [0, 1, float("nan")]}, "axis"),
    ("an infinite E I", CANTILEVER | {"bending_stiffness": float("inf")}, "bending_stiffness"),
    ("a negative G J", CANTILEVER | {"torsional_stiffness": -700.0}, "torsional_stiffness"),
    ("a negative E A", CANTILEVER | {"axial_stiffness": -1.0}, "axial_stiffness"),
    ("no length", CANTILEVER | {"length": 0.0}, "length"),
    ("a negative length", CANTILEVER | {"length": -0.1}, "length"),
    ("a length of something", CANTILEVER | {"length": {"joint": "passive_slider_joint"}}, "length"),
    ("a length that starts nowhere", CANTILEVER | {"length": {"joint": "j", "at_zero": float("nan")}}, "at_zero"),
    ("a ragged matrix", BEAM | {"matrix": [[1.0, 2.0], [1.0]]}, "matrix"),
    ("no matrix", BEAM | {"matrix": 3.0}, "matrix"),
    ("a matrix of another size", BEAM | {"matrix": SYMMETRIC.tolist()}, "matrix"),
    ("not symmetric", CLOSURE | {"matrix": (SYMMETRIC + np.eye(3, k=1)).tolist()}, "symmetric"),
    ("not definite", CLOSURE | {"matrix": (SYMMETRIC + 9 * np.eye(3, k=1) + 9 * np.eye(3, k=-1)).tolist()}, "definite"),
    ("negative diagonal", CLOSURE | {"matrix": (-SYMMETRIC).tolist()}, "diagonal"),
    ("singular", CLOSURE | {"matrix": np.ones((3, 3)).tolist()}, "definite"),
    ("not a number in a matrix", CLOSURE | {"matrix": (SYMMETRIC * np.nan).tolist()}, "matrix"),
    ("no closure", CLOSURE | {"closure": -1}, "closure"),
    ("a closure by name", CLOSURE | {"closure": "first"}, "closure"),
]


@pytest.mark.parametrize(("entry", "said"), [wrong[1:] for wrong in WRONG], ids=[wrong[0] for wrong in WRONG])
def test_a_wrong_entry_is_named_with_its_file(entry: dict[str, Any], said: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        read_springs([entry], FILE)
    assert str(FILE) in str(caught.value)
    assert "springs[0]" in str(caught.value)
    assert said in str(caught.value)
    if entry.get("name"):
        assert f"'{entry['name']}'" in str(caught.value)


def test_two_springs_with_one_name() -> None:
    with pytest.raises(DescriptionError, match=r"springs\[1\].*'a'"):
        read_springs([JOINT, AXIAL | {"name": "a"}], FILE)


def test_a_matrix_with_other_units_on_its_diagonal_is_judged_by_its_numbers_not_its_units() -> None:
    """An Euler-Bernoulli tip of millimetre thickness: 1e9 N/m next to 1e1 N m/rad, and still definite."""
    matrix = np.diag([1e12, 1.0, 1.0])
    (spring,) = read_springs([CLOSURE | {"matrix": matrix.tolist()}], FILE)
    assert isinstance(spring, ClosureSpring)


@pytest.mark.parametrize(
    ("spring", "error", "said"),
    [
        (JointSpring("a", "slider9_joint", 1.0, "N/m"), JointNotFoundError, "slider9_joint"),
        (AxialSpring("a", "link9_tip", (0, 0, 1), 1.0), FrameNotFoundError, "link9_tip"),
        (BeamSpring("a", "nowhere", np.eye(6)), FrameNotFoundError, "nowhere"),
        (CantileverSpring("a", "P", (0, 0, 1), 1.0, 1.0, JointLength("no_joint", 1.0)), JointNotFoundError, "no_joint"),
        (
            CantileverSpring("a", "P", (0, 0, 1), 1.0, 1.0, JointLength("platform_x_joint", 1.0)),
            DescriptionError,
            "is revolute",
        ),
        (JointSpring("a", "slider1_joint", 1.0, "N m/rad"), DescriptionError, "N/m"),
        (JointSpring("a", "platform_x_joint", 1.0, "N/m"), DescriptionError, "N m/rad"),
        (ClosureSpring("a", 3, np.eye(3)), DescriptionError, "less than 3"),
        (ClosureSpring("a", 0, np.eye(6)), DescriptionError, "3 x 3"),
        (AxialSpring("a", "universe", (0, 0, 1), 1.0), DescriptionError, "root"),
    ],
)
def test_a_spring_that_does_not_fit_the_mechanism(
    mechanism: Robot, spring: Any, error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said) as caught:
        ElasticModel(mechanism, [spring])
    assert "spring 'a'" in str(caught.value)
    assert str(mechanism.source) in str(caught.value)


def test_two_springs_at_one_place(mechanism: Robot) -> None:
    at_joint = [JointSpring(name, "slider1_joint", 1.0, "N/m") for name in "ab"]
    with pytest.raises(DescriptionError, match="already has a spring"):
        ElasticModel(mechanism, at_joint)
    at_closure = [ClosureSpring(name, 1, np.eye(3)) for name in "ab"]
    with pytest.raises(DescriptionError, match="two springs"):
        ElasticModel(mechanism, at_closure)
    same_name = [AxialSpring("a", "link1_tip", (0, 0, 1), 1.0), AxialSpring("a", "link2_tip", (0, 0, 1), 1.0)]
    with pytest.raises(DescriptionError, match="duplicate name"):
        ElasticModel(mechanism, same_name)


def test_a_mechanism_without_springs(mechanism: Robot) -> None:
    with pytest.raises(DescriptionError, match="springs"):
        ElasticModel(mechanism, [])


def test_springs_made_in_code_are_checked_too() -> None:
    with pytest.raises(InvalidValueError, match="stiffness"):
        JointSpring("a", "j", float("nan"), "N/m")
    with pytest.raises(InvalidValueError, match="symmetric"):
        BeamSpring("a", "j", np.eye(6) + np.eye(6, k=1))
    with pytest.raises(InvalidValueError, match="axis"):
        AxialSpring("a", "j", (0.0, 0.0, 0.0), 1.0)


def test_the_description_of_the_tripod(elastic: ElasticModel) -> None:
    """Three actuators, three links and the passive leg, with the chapter's printed numbers."""
    springs = {spring.name: spring for spring in elastic.springs}
    assert springs["actuator2"] == JointSpring("actuator2", "slider2_joint", 9.5950e7, "N/m")
    assert springs["link3"] == AxialSpring("link3", "link3_tip", (0.0, 0.0, 1.0), 1.5177e10)
    leg = springs["passive_leg"]
    assert isinstance(leg, CantileverSpring)
    assert (leg.bending_stiffness, leg.torsional_stiffness, leg.axial_stiffness) == (899.6698, 697.4185, None)
    assert len(springs) == 7
