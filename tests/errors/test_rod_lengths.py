"""The length of a rod that is a closure of type "distance" is an error like any other."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.error_file import error_file_text
from pm3dof_pin.errors.body_temperatures import BodyTemperatures
from pm3dof_pin.errors.error_parameters import GeometricErrors, GeometricParameter, TiedParameter
from pm3dof_pin.errors.minimal_parameters import error_entries, minimal_parameters
from pm3dof_pin.errors.pose_error import pose_difference
from pm3dof_pin.errors.presets import preset
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.kinematics.poses import Poses

RODS = tuple(f"tip{k}-ball{k}.t_along" for k in range(6))
STEP = 1e-5


@pytest.fixture(scope="module")
def errors(six_rods: Path) -> GeometricErrors:
    return GeometricErrors.load(six_rods)


@pytest.fixture(scope="module")
def poses(errors: GeometricErrors) -> Poses:
    return pm.reachable_poses(errors.robot, 40, np.random.default_rng(1))


def _by_legs(poses: Poses) -> np.ndarray:
    """Textbook: J x = dl, with rows [s, r x s] of the unit vector s along each rod, and r from the tool to its ball."""
    found = []
    for pose in poses:
        places = pose.frame_placement
        rows = []
        for k in range(6):
            tip, ball = (places(f"{end}{k}").translation for end in ("tip", "ball"))
            along = (ball - tip) / np.linalg.norm(ball - tip)
            rows.append([*along, *np.cross(ball - pose.tool_placement.translation, along)])
        found.append(np.linalg.inv(rows))
    return np.array(found)


@pytest.mark.usefixtures("programs_for_few_poses")
@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_the_tool_moves_by_the_inverse_of_the_legs(errors: GeometricErrors, poses: Poses, engine: pm.Engine) -> None:
    found = pm.sensitivities(errors, poses, engine=engine)
    expected = _by_legs(poses)
    chosen = [errors.names.index(name) for name in RODS]
    np.testing.assert_allclose(found.errors[:, :, chosen], expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.usefixtures("programs_for_few_poses")
@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_sensitivities_are_differences(errors: GeometricErrors, poses: Poses, engine: pm.Engine) -> None:
    """At errors of millimetres, of rods, of what moves them, and of a tie of both."""
    parts = [errors.parameters[errors.names.index(name)] for name in ("tip1.tx", RODS[1])]
    tie = TiedParameter("leg", ((parts[0], 1.0), (parts[1], -2.0)), "legs", 1e-4)
    some = [p for p in errors.parameters if p.name in (*RODS, "ball0.ty", "m3.rx")]
    chosen = GeometricErrors(errors.robot, [*some, tie])
    values = 10.0 * chosen.sample(np.random.default_rng(2))
    poses = chosen.apply(values).forward(poses.commands[:5], guess=poses.q[:5])
    columns = []
    for step in STEP * np.eye(len(chosen)):
        back, ahead = (chosen.apply(values + s).forward(poses.commands, guess=poses.q) for s in (-step, step))
        columns.append(pose_difference(back.transforms, ahead.transforms) / (2.0 * STEP))
    found = pm.sensitivities(chosen, poses, values, engine=engine).errors
    np.testing.assert_allclose(found, np.stack(columns, axis=2), atol=1e-5)


def test_a_slide_on_a_rod() -> None:
    """Slides along x and z at the ends of a rod: z = sqrt(l^2 - x^2), with l and its zeros in closed form."""
    model = pin.Model()
    for axis, foot in ((pin.JointModelPX(), "foot"), (pin.JointModelPZ(), "head")):
        joint = model.addJoint(0, axis, pin.SE3.Identity(), f"{foot}_slide")
        frame = model.addJointFrame(joint)
        model.addFrame(pin.Frame(foot, joint, frame, pin.SE3.Identity(), pin.FrameType.BODY))
    model.referenceConfigurations["home"] = np.array([0.6, 0.8])
    rod = LoopClosure("foot", "head", "distance", length=1.0)  # an entry of programs that is a constant
    errors = GeometricErrors(pm.Robot(model, [rod], actuated_joints=["foot_slide"], tool_frame="head"))
    commands = np.linspace(0.5, 0.7, 7)
    longer = errors.apply({"foot-head.t_along": 2e-3}).forward(commands[:, None])
    np.testing.assert_allclose(longer.positions[:, 2], np.sqrt(1.002**2 - commands**2), atol=1e-12)


def test_sets_are_complete(errors: GeometricErrors) -> None:
    """As many as the rank of differences: per leg five of the motor, one of the arm, the rod, and three of its ball."""
    poses = pm.reachable_poses(errors.robot, 60, np.random.default_rng(0))
    assert errors.names[-6:] == RODS
    columns = []
    for step in 1e-4 * np.eye(len(errors)):
        back, ahead = (errors.apply(s).forward(poses.commands, guess=poses.q).transforms for s in (-step, step))
        columns.append((pose_difference(back, ahead) * [1, 1, 1, 0.1, 0.1, 0.1]).ravel())
    shown = np.array(columns).T * errors.tolerances
    values = np.linalg.svd(shown, compute_uv=False)
    assert values[65] > 30.0 * values[66]
    found = minimal_parameters(errors, poses)
    assert len(found) == 66
    assert set(RODS) <= set(found.names)


def test_an_error_file_names_rods(errors: GeometricErrors, tmp_path: Path) -> None:
    entries, _ = preset(errors.robot, "complete", "medium")
    path = tmp_path / "six.errors.yaml"
    path.write_text(error_file_text(entries, comment="Found.", command_zeros={}))
    again = GeometricErrors.from_file(errors.robot, path)
    rods = [p for p in again.parameters if p.name in RODS]
    # ISO 2768-1, medium: 0.5 mm for lengths of 120 to 400 mm, two standard deviations
    assert [(p.group, p.tolerance) for p in rods] == 6 * [("legs_to_400_mm", 0.25e-3)]
    alike = GeometricErrors(errors.robot, rods)
    path.write_text(error_file_text(error_entries(alike), comment="Rods.", command_zeros={}))
    assert GeometricErrors.from_file(errors.robot, path).parameters == alike.parameters
    path.write_text(f"ties: {{cut: {{of: [{', '.join(RODS)}], tolerance_m: 1.0e-3}}}}")
    tied = GeometricErrors.from_file(errors.robot, path)
    nominal = [loop.length for loop in errors.robot.closures]
    lengths = [loop.length for loop in tied.apply([1e-3]).closures]
    np.testing.assert_allclose(lengths, np.add(nominal, 1e-3), rtol=1e-15)


@pytest.mark.parametrize("words", ["translation: x", "translation: [along], rotation: [along]", "translation: across"])
def test_other_errors_of_rods_are_refused(errors: GeometricErrors, words: str, tmp_path: Path) -> None:
    path = tmp_path / "six.errors.yaml"
    body = f"length_tolerance_m: 1.0e-4, angle_tolerance_rad: 1.0e-3, errors: [{{at: tip0-ball0, {words}}}]"
    path.write_text(f"classes: {{legs: {{{body}}}}}")
    with pytest.raises((DescriptionError, InvalidValueError), match=r"tip0-ball0.*along"):
        GeometricErrors.from_file(errors.robot, path)
    wrong = GeometricParameter("aside", "tip0-ball0", "translation", (0.0, 1.0, 0.0), "legs", 1e-4)
    with pytest.raises(InvalidValueError, match=re.escape("tip0-ball0.t_along")):
        GeometricErrors(errors.robot, [wrong])


def test_a_rod_without_length_is_refused(errors: GeometricErrors) -> None:
    with pytest.raises(InvalidValueError, match="length"):
        errors.apply({RODS[0]: -1.0})


def test_warm_rods_grow_by_their_temperature_only(errors: GeometricErrors, poses: Poses) -> None:
    """All equally warm, the machine scales about its base, whatever errors are declared; sources have rods, too."""
    heat = BodyTemperatures(errors.robot, np.zeros(6))
    scaled = heat.motions(poses[:5], {"all": 10.0})
    expected = 10.0 * heat.numbers.expansion_per_K * poses.positions[:5]
    np.testing.assert_allclose(scaled[:, :3], expected, atol=1e-9)
    np.testing.assert_allclose(scaled[:, 3:], 0.0, atol=1e-9)
    sources = {source.name: source for source in ErrorSources(errors).at(poses[:5])}
    assert {f"tip{k}-ball{k}" for k in range(6)} == set(ErrorSources(errors).thermal_growth.rods)
    assert all(np.isfinite(source.effects).all() for source in sources.values())


def test_firmware_lengthens_rods(tmp_path: Path) -> None:
    """A printer's arms that are closures: the tie of each tower's arms is the lengths of its two rods."""
    slides, rods = [], []
    fixed = '<link name="{1}"/><joint name="{1}_fixed" type="fixed"><parent link="{0}"/><child link="{1}"/>{2}</joint>'
    for k, angle in enumerate((0.0, 2.0 * np.pi / 3.0, -2.0 * np.pi / 3.0)):
        out, side = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        places = {f"car{k}": [*(0.2 * out), 0.4], f"t{k}l": [0.0, 0.03, 0.0], f"t{k}r": [0.0, -0.03, 0.0]}
        places |= {f"e{k}{end}": [*(0.05 * out + y * side), 0.0] for end, y in (("l", 0.03), ("r", -0.03))}
        turn = {f"car{k}": f'rpy="0 0 {angle:.17g}"'}
        at = {name: f'<origin xyz="{x:.17g} {y:.17g} {z}" {turn.get(name, "")}/>' for name, (x, y, z) in places.items()}
        slides.append(
            f'<link name="car{k}"/><joint name="s{k}" type="prismatic"><parent link="base"/><child link="car{k}"/>'
            f'{at[f"car{k}"]}<axis xyz="0 0 1"/><limit lower="-0.2" upper="0.2"/></joint>'
        )
        for end in "lr":
            slides += [fixed.format(f"car{k}", f"t{k}{end}", at[f"t{k}{end}"])]
            slides += [fixed.format("plate", f"e{k}{end}", at[f"e{k}{end}"])]
            rods.append(f"[t{k}{end}, e{k}{end}]")
    tree, carrier = [], "base"
    for joint, kind, axis in zip("xyzabc", 3 * ["prismatic"] + 3 * ["revolute"], 2 * [0, 1, 2], strict=True):
        link = "plate" if joint == "c" else f"{joint}l"
        unit = " ".join("1" if k == axis else "0" for k in range(3))
        tree.append(
            f'<link name="{link}"/><joint name="{joint}" type="{kind}"><parent link="{carrier}"/><child link="{link}"/>'
            f'<axis xyz="{unit}"/><limit lower="-0.5" upper="0.5"/></joint>'
        )
        carrier = link
    path = tmp_path / "printer.urdf"
    path.write_text(f'<robot name="printer"><link name="base"/>{"".join(tree + slides)}</robot>')
    path.with_suffix(".closures.yaml").write_text(
        f"closed_loop: [{', '.join(rods)}]\ntype: [{', '.join(6 * ['distance'])}]\n"
        f"closure_lengths: {6 * [float(np.hypot(0.15, 0.4))]}\nname_mot: [s0, s1, s2]\ntool_frame: plate\n"
        "tool_motions: [x, y, z]\n"
    )
    _, ties = preset(pm.load(path), "firmware-delta-9")
    arms = {tie.name: dict(tie.parts) for tie in ties if tie.name.startswith("arm")}
    assert arms == {f"arm{k + 1}": {f"t{k}{s}-e{k}{s}.t_along": 1.0 for s in "lr"} for k in range(3)}
