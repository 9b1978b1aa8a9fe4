"""The parameter file read into SI numbers, and refused with the place of the error."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pm3dof_pin.description.parameters import TripodParameters, _default_parameters_path
from pm3dof_pin.exceptions import DescriptionError

Tree = dict[str, Any]


@pytest.fixture(scope="module")
def tree() -> Tree:
    """The chapter's parameter file as plain data."""
    data: Tree = yaml.safe_load(_default_parameters_path().read_text(encoding="utf-8"))
    return data


@pytest.fixture
def load_edited(tree: Tree, tmp_path: Path) -> Callable[[Callable[[Tree], None]], TripodParameters]:
    """Load the chapter's parameters after a change of the data."""

    def load(edit: Callable[[Tree], None]) -> TripodParameters:
        edited = copy.deepcopy(tree)
        edit(edited)
        path = tmp_path / "edited.yaml"
        path.write_text(yaml.safe_dump(edited), encoding="utf-8")
        return TripodParameters.load(path)

    return load


def test_the_numbers_are_those_of_tables_8_1_and_8_2() -> None:
    parameters = TripodParameters.load()
    np.testing.assert_array_equal(parameters.base_joint_angles, np.radians([-30.0, 90.0, -150.0]))
    np.testing.assert_array_equal(parameters.platform_joint_angles, np.radians([-30.0, 90.0, -150.0]))
    assert parameters.leg_count == 3
    assert parameters.base_radius == 0.37425
    assert parameters.platform_radius == 0.075
    assert parameters.link_length == 0.353
    assert parameters.guide_slope == math.radians(50.0)
    assert parameters.platform_joint_height == 0.013
    assert (parameters.slider_home, parameters.slider_stroke) == (0.240272, 0.085)
    assert (parameters.spherical_limit, parameters.universal_limit) == (math.radians(45.0), math.radians(50.0))
    assert parameters.platform_mass == 0.38
    assert (parameters.link_mass, parameters.slider_mass, parameters.passive_leg_mass) == (0.1945, 0.3045, 0.2)
    np.testing.assert_array_equal(parameters.platform_moments, [0.002830, 0.002123, 0.004953])
    np.testing.assert_array_equal(parameters.link_moments, [0.000717, 0.000717, 0.000010])
    assert (parameters.actuator_stiffness, parameters.link_stiffness) == (9.5950e7, 1.5177e10)
    assert (parameters.bending_stiffness, parameters.torsional_stiffness) == (899.6698, 697.4185)


def test_every_quantity_says_where_it_comes_from() -> None:
    for key, quantity in TripodParameters.load().quantities.items():
        assert len(quantity.source) > 5, key
        assert (quantity.status == "chosen") >= key.startswith("drawing."), key


def test_the_arrays_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        TripodParameters.load().base_joint_angles[0] = 0.0


def test_lengths_may_be_given_in_metres(load_edited: Callable[..., TripodParameters]) -> None:
    def in_metres(tree: Tree) -> None:
        tree["geometry"]["link_length"].update(value=0.4, unit="m")

    assert load_edited(in_metres).link_length == 0.4


def _set(section: str, name: str, **entries: Any) -> Callable[[Tree], None]:
    return lambda tree: tree[section][name].update(entries)


def _remove(section: str, name: str, key: str | None = None) -> Callable[[Tree], None]:
    return lambda tree: tree[section].pop(name) if key is None else tree[section][name].pop(key)


@pytest.mark.parametrize(
    ("edit", "element", "said"),
    [
        (_remove("geometry", "link_length"), "geometry.link_length", "is missing"),
        (_remove("geometry", "link_length", "unit"), "geometry.link_length.unit", "is missing"),
        (_set("geometry", "link_length", value=math.nan), "geometry.link_length.value", "a finite number, not nan"),
        (_set("inertia", "link_mass", value=math.inf), "inertia.link_mass.value", "a finite number, not inf"),
        (_set("inertia", "link_mass", value="heavy"), "inertia.link_mass.value", "a number or a list, not 'heavy'"),
        (_set("inertia", "link_mass", value=True), "inertia.link_mass.value", "a number or a list, not True"),
        (
            _set("inertia", "link_mass", value=-0.1),
            "inertia.link_mass.value",
            "expected a nonnegative number, not -0.1 kg",
        ),
        (_set("inertia", "link_mass", value=[0.1, 0.2]), "inertia.link_mass.value", "one number, not a list"),
        (_set("inertia", "link_mass", unit="lb"), "inertia.link_mass.unit", "expected one of 1, m, kg, kg m^2"),
        (
            _set("inertia", "link_mass", status="guessed"),
            "inertia.link_mass.status",
            "inferred, chosen, not 'guessed'",
        ),
        (_set("inertia", "link_moments", value=[1.0, 2.0]), "inertia.link_moments.value", "a list of 3 numbers"),
        (
            _set("geometry", "platform_joint_angles", value=[0.0, 120.0]),
            "geometry.platform_joint_angles.value",
            "a list of 3 numbers",
        ),
        (_set("geometry", "link_length", tolerance=1.0), "geometry.link_length.tolerance", "unknown key"),
        (_set("drawing", "tool_radius", value=math.nan), "drawing.tool_radius.value", "a finite number"),
    ],
)
def test_a_wrong_quantity_is_named(
    load_edited: Callable[..., TripodParameters], edit: Callable[[Tree], None], element: str, said: str
) -> None:
    with pytest.raises(DescriptionError) as caught:
        load_edited(edit)
    assert caught.value.element == element
    assert "edited.yaml" in str(caught.value)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "element", "said"),
    [
        ("name: x\ngeometry:\n  base_radius: {value: 1.0\n", "line 4", "expected YAML"),
        ("- a\n- b\n", "file", "expected a mapping"),
        ("", "file", "expected a mapping"),
        ("a: !!python/object/apply:os.getcwd []\n", "line 1", "expected YAML"),
    ],
)
def test_what_is_no_parameter_file_is_refused(tmp_path: Path, text: str, element: str, said: str) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError, match=said) as caught:
        TripodParameters.load(path)
    assert (caught.value.path, caught.value.element) == (path, element)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"nowhere\.yaml: file: expected a readable file"):
        TripodParameters.load(tmp_path / "nowhere.yaml")


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "picture.yaml"
    path.write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(DescriptionError, match="expected UTF-8 text"):
        TripodParameters.load(path)
