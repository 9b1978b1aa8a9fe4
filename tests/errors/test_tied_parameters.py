"""Parameters that displace several places, and sets of parameters by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.errors.error_parameters import GeometricErrors, TiedParameter
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import PM3DofError

TEXT = """
classes:
  platform: {length_tolerance_m: 1.0e-4, angle_tolerance_rad: 1.0e-3, errors: [{at: carriage2_joint, translation: x}]}
ties:
  radius: {of: [carriage1_joint.tx, carriage2_joint.tx, carriage3_joint.tx], tolerance_m: 1.0e-3}
  opposite: {of: {carriage1_joint.tz: 1.0, carriage2_joint.t_along: -2.0}, tolerance_m: 2.0e-3, class: drives}
  tilt: {of: {carriage1_joint.rx: 1.0, carriage3_joint.ry: 0.5}, tolerance_rad: 1.0e-3}
"""


@pytest.fixture
def tied(tmp_path: Path) -> GeometricErrors:
    path = tmp_path / "delta.errors.yaml"
    path.write_text(TEXT)
    return GeometricErrors.from_file(pm.load("linear_delta"), path)


def test_a_tie_displaces_its_places_alike(tied: GeometricErrors) -> None:
    assert tied.names == ("carriage2_joint.tx", "radius", "opposite", "tilt")
    assert tied.groups == ("platform", "tied", "drives")
    np.testing.assert_array_equal(tied.tolerances, [1e-4, 1e-3, 2e-3, 1e-3])
    by_places = GeometricErrors(tied.robot).apply(
        {
            **dict.fromkeys(("carriage1_joint.tx", "carriage3_joint.tx"), 3e-4),
            "carriage2_joint.tx": 5e-4,
            "carriage1_joint.tz": 1e-4,
            "carriage2_joint.tz": -2e-4,
            "carriage1_joint.rx": 1e-3,
            "carriage3_joint.ry": 5e-4,
        }
    )
    at_once = tied.apply({"radius": 3e-4, "carriage2_joint.tx": 2e-4, "opposite": 1e-4, "tilt": 1e-3})
    commands = pm.reachable_poses(tied.robot, 5, np.random.default_rng(0)).commands
    np.testing.assert_allclose(
        at_once.forward(commands).transforms, by_places.forward(commands).transforms, rtol=0.0, atol=1e-12
    )


@pytest.mark.parametrize("count", [5, 120])
def test_sensitivities_are_differences(tied: GeometricErrors, count: int) -> None:
    poses = pm.reachable_poses(tied.robot, count, np.random.default_rng(1))
    values = np.array([1e-4, 2e-4, -1e-4, 1e-3])
    moved = tied.apply(values).forward(poses.commands, guess=poses.q)
    found = pm.sensitivities(tied, moved, values).errors
    for k in range(len(tied)):
        step = 1e-6 * np.eye(len(tied))[k]
        ends = [tied.apply(values + s * step).forward(poses.commands, guess=poses.q).positions for s in (1, -1)]
        np.testing.assert_allclose(found[:, :3, k], (ends[0] - ends[1]) / 2e-6, atol=2e-6)


def test_some_of_them(tied: GeometricErrors) -> None:
    assert tied.select(["tilt", "radius"]).names == ("tilt", "radius")
    assert set(closable(tied).names) <= set(tied.names)
    assert len(pm.error_map(tied, pm.reachable_poses(tied.robot, 3, np.random.default_rng(0))).tip_rms) == 3


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("carriage1_joint.tz: 1.0", "carriage1_joint.rz: 1.0", "translations with tolerance_m"),
        ("carriage1_joint.tz: 1.0", "nowhere.tz: 1.0", "nowhere"),
        ("carriage1_joint.tz: 1.0", "carriage1_joint.z: 1.0", "carriage1_joint.tx"),
        ("tolerance_m: 2.0e-3, ", "", "tolerance_m or tolerance_rad"),
        ("[carriage1_joint.tx, carriage2_joint.tx, carriage3_joint.tx]", "[]", "with parts"),
        ("carriage1_joint.tz: 1.0", "carriage1_joint.tz: 0.0", "factor of carriage1_joint.tz other than 0"),
        ("carriage1_joint.tz: 1.0", "carriage1_joint.tz: .nan", "finite|number"),
        ("[carriage1_joint.tx, carriage2", "[carriage1_joint.tx, carriage1_joint.tx, carriage2", "tx twice"),
        ("carriage1_joint.tz: 1.0", "carriage2_joint.tz: 2.0", "displacement once"),  # that of t_along, by another name
    ],
)
def test_malformed_ties(tmp_path: Path, old: str, new: str, word: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(PM3DofError, match=word):
        GeometricErrors.from_file(pm.load("linear_delta"), path)


def test_ties_made_in_python_are_checked_too(tied: GeometricErrors) -> None:
    radius = next(parameter for parameter in tied.parameters if parameter.name == "radius")
    assert isinstance(radius, TiedParameter)
    (first, _), *others = radius.parts
    longer = replace(others[0][0], axis=(2.0, 0.0, 0.0))  # would count twice
    for parts, word in (
        (((first, 0.0), *others), "not 0"),
        (((first, 1.0), *radius.parts), "once"),
        (((first, 1.0), (longer, 1.0)), f"axis of {longer.name} .*unit vector"),
    ):
        with pytest.raises(PM3DofError, match=word):
            GeometricErrors(tied.robot, [replace(radius, parts=parts)])


@pytest.mark.parametrize("count", [6, 7, 9])
def test_firmware_of_a_printer(run: Callable[..., Any], tmp_path: Path, count: int) -> None:
    """Rigid motions of three towers and lengths of arms, against the printer's equation |carriage - effector| = arm."""
    preset = f"firmware-delta-{count}"
    answer = run("error-parameters", "--robot", "linear_delta", "--preset", preset, "--out", "p.yaml", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    robot = pm.load("linear_delta")
    errors = GeometricErrors.from_file(robot, tmp_path / "p.yaml")
    assert len(errors) == count
    values = 0.3 * errors.tolerances * np.random.default_rng(2).standard_normal(count)
    named = dict(zip(errors.names, values, strict=True))
    reached = errors.apply(values).forward(robot.solve([[0.03, -0.02, 0.1], [-0.05, 0.04, 0.2]]).commands)
    nominal, home = robot.solve([[0.03, -0.02, 0.1], [-0.05, 0.04, 0.2]]), robot.home
    for k, degrees in enumerate((210.0, 330.0, 90.0)):
        angle = np.radians(degrees)
        out, side = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        joint, tip, end = (
            home.frame_placement(name.format(k + 1)).translation
            for name in ("rod{}_left_first_joint", "rod{}_left_tip", "B{}_left")
        )
        # as the rods are parallel, from the carriage's joint to a point that moves with the tool
        radius, length = float((joint - end) @ out), float(np.linalg.norm(tip - joint))
        across = radius * out - nominal.positions * [1.0, 1.0, 0.0]
        height = nominal.positions[:, 2] + np.sqrt(length**2 - np.sum(across**2, axis=1))
        carriage = (radius + named["radius"]) * out + named.get(f"tangent{k + 1}", 0.0) * side
        carriage = carriage + np.outer(height + named[f"end_stop{k + 1}"], [0.0, 0.0, 1.0])
        longer = named.get("arms", 0.0) + named.get(f"arm{k + 1}", 0.0)
        distances = np.linalg.norm(carriage - reached.positions, axis=1)
        np.testing.assert_allclose(distances, length + longer, atol=1e-9)


def test_presets_by_kind(run: Callable[..., Any], tmp_path: Path) -> None:
    answers = [
        run("error-parameters", "--robot", robot, "--preset", name, "--out", "x.yaml", cwd=tmp_path)
        for robot, name in (("hexapod", "firmware-delta-6"), ("hexapod", "dh"), ("hexapod", "zeros-only"))
    ]
    assert [answer.returncode for answer in answers] == [1, 1, 0]
    assert "three sliding drives" in answers[0].stderr
    assert "serial arm" in answers[1].stderr
    assert len(GeometricErrors.from_file(pm.load("hexapod"), tmp_path / "x.yaml")) == 6
    with pytest.raises(PM3DofError, match="strut1_joint"):
        GeometricErrors.from_file(pm.load("linear_delta"), tmp_path / "x.yaml")
