"""Sensitivities against central differences of the closed-loop kinematics."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.pose_error import pose_difference
from pm3dof_pin.errors.sensitivity import closable, sensitivities
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import legs, walker

MACHINES = Path(__file__).parents[1] / "machines"
STEP = 1e-5
AGREEMENT = 1e-6


def _motion(first: Poses, second: Poses) -> np.ndarray:
    turn = [pin.log3(b @ a.T) for a, b in zip(first.rotations, second.rotations, strict=True)]
    return np.concatenate([second.positions - first.positions, turn], axis=1) / (2.0 * STEP)


def _differences(errors: GeometricErrors, poses: Poses, values: np.ndarray, chosen: slice | None = None) -> np.ndarray:
    columns = []
    for index in range(len(errors))[chosen or slice(None)]:
        step = STEP * np.eye(len(errors))[index]
        first, second = (errors.apply(values + s).forward(poses.commands, guess=poses.q) for s in (-step, step))
        columns.append(_motion(first, second))
    return np.stack(columns, axis=2)


def _some(errors: GeometricErrors) -> slice:
    """All parameters of small robots; of others every fifth, a different one of the six at each place."""
    return slice(None, None, 5 if len(errors) > 100 else 1)


def test_errors_against_finite_differences(case: Poses) -> None:
    errors = closable(GeometricErrors(case.robot), case)
    chosen = _some(errors)
    expected = _differences(errors, case, errors.zeros, chosen)
    np.testing.assert_allclose(sensitivities(errors, case).errors[:, :, chosen], expected, atol=AGREEMENT)


def test_errors_against_finite_differences_far_from_nominal(case: Poses) -> None:
    """For errors of centimetres and tenths of a radian, the derivative of the displacement itself matters."""
    errors = closable(GeometricErrors(case.robot), case)
    values = 20.0 * errors.sample(np.random.default_rng(2))
    poses = errors.apply(values).forward(case.commands, guess=case.q)
    analytic, chosen = sensitivities(errors, poses, values).errors, _some(errors)
    np.testing.assert_allclose(analytic[:, :, chosen], _differences(errors, poses, values, chosen), atol=AGREEMENT)


def test_commands_against_finite_differences(case: Poses) -> None:
    analytic = sensitivities(GeometricErrors(case.robot, []), case).commands
    for index in range(analytic.shape[2]):
        step = STEP * np.eye(analytic.shape[2])[index]
        first, second = (case.robot.forward(case.commands + s, guess=case.q) for s in (-step, step))
        np.testing.assert_allclose(analytic[:, :, index], _motion(first, second), atol=AGREEMENT)


def test_an_offset_is_a_change_of_command(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """A displacement along a prismatic joint's axis adds to its coordinate: (8.9) in another form."""
    derivatives = sensitivities(tripod_errors, tripod_nominal)
    axis = np.array([-0.5566703992264195, 0.3213938048432696, 0.766044443118978])
    offset = [tripod_errors.names.index(f"slider1_joint.t{axis_name}") for axis_name in "xyz"]
    np.testing.assert_allclose(derivatives.errors[:, :, offset] @ axis, derivatives.commands[:, :, 0], atol=1e-12)


def test_a_leg_that_carries_the_tool_closes_with_all_its_errors(tmp_path: Path) -> None:
    """Two sliding legs that turn in a plane and meet; the first carries a lift.

    The first leg's rotation about its own axis, alone, moves the tool and not the loop; with an in-plane offset of its
    tip from that axis, it lifts the tip out of the plane.
    """

    def joint(name: str, kind: str, parent: str, child: str, place: str, axis: str) -> str:
        limit = '<limit lower="-0.5" upper="0.5" effort="1" velocity="1"/>'
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{limit}</joint><link name="{child}"/>'

    joints = (
        joint("turn1", "revolute", "base", "swing1", "0 0 0", "0 0 1"),
        joint("leg1", "prismatic", "swing1", "rod1", "0.3 0 0", "1 0 0"),
        joint("turn2", "revolute", "base", "swing2", "0.3 -0.3 0", "0 0 1"),
        joint("leg2", "prismatic", "swing2", "rod2", "0 0.3 0", "0 1 0"),
        joint("lift", "prismatic", "rod1", "pen", "0 0 0.1", "0 0 1"),
    )
    tips = "".join(
        f'<joint name="t{k}" type="fixed"><parent link="rod{k}"/><child link="tip{k}"/></joint><link name="tip{k}"/>'
        for k in (1, 2)
    )
    (tmp_path / "legs.urdf").write_text(f'<robot name="legs"><link name="base"/>{"".join(joints)}{tips}</robot>')
    closures = 'closed_loop: [[tip1, tip2]]\ntype: ["3d"]\nname_mot: [leg1, leg2, lift]\ntool_frame: pen\n'
    (tmp_path / "legs.closures.yaml").write_text(closures)
    errors = closable(GeometricErrors(Robot.load(tmp_path / "legs.urdf")))
    assert "leg1.rx" not in errors.names
    assert {"leg1.ty", "tip1.ty", "lift.rx"} <= set(errors.names)
    machine = errors.apply(errors.sample(np.random.default_rng(0)))
    assert machine.forward(np.zeros((1, 3)), on_failure="nan").solved.all()


def test_what_cannot_close_is_left_out_and_named(four_bar: Path) -> None:
    """A planar four-bar does not close with a tilted or raised pivot, but with in-plane lengths and offsets."""
    mechanism = Robot.load(four_bar)
    errors, poses = GeometricErrors(mechanism), mechanism.forward([[0.2], [-0.3]])
    assert set(errors.names) - set(closable(errors, poses).names) == {
        f"{place}.{motion}"
        for place, motions in {
            "crank_joint": ("tz", "rx", "ry"),
            "coupler_joint": ("tz", "rx", "ry"),
            "rocker_joint": ("tz", "rx", "ry"),
            "coupler_tip": ("tz",),
            "rocker_tip": ("tz",),
        }.items()
        for motion in motions
    }
    with pytest.raises(InvalidValueError, match=r"rocker_joint\.tz"):
        sensitivities(errors, poses)


def test_a_tool_that_commands_do_not_hold_is_refused(four_bar: Path) -> None:
    loose = Robot(Robot.load(four_bar).model, (), actuated_joints=["crank_joint"], tool_frame="pen")
    poses = loose.forward([[0.2]])
    with pytest.raises(SingularConfigurationError, match="locked at pose 0"):
        sensitivities(GeometricErrors(loose, []), poses)


@pytest.mark.parametrize("slope", [1e-2, 1e-7])
def test_slides_along_nearly_one_direction_leave_the_tool_loose(slope: float, tmp_path: Path) -> None:
    """A drive along x pushes three slides: along y and z, and the first along y as well, but for a slope."""
    axes = {"drive": "1 0 0", "first": f"{slope} 1 0", "second": "0 1 0", "third": "0 0 1"}
    parents = {"drive": "base", "first": "base", "second": "first", "third": "second"}
    joints = "".join(
        f'<link name="{name}"/><joint name="{name}" type="prismatic"><parent link="{parents[name]}"/>'
        f'<child link="{name}"/><axis xyz="{axis}"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for name, axis in axes.items()
    )
    tip = '<link name="{0}_tip"/><joint name="{0}_tip" type="fixed"><parent link="{0}"/><child link="{0}_tip"/></joint>'
    tips = "".join(tip.format(name) for name in ("drive", "third"))
    (tmp_path / "slides.urdf").write_text(f'<robot name="slides"><link name="base"/>{joints}{tips}</robot>')
    closures = "closed_loop: [[drive_tip, third_tip]]\ntype: [3d]\nname_mot: [drive]\ntool_frame: first\n"
    (tmp_path / "slides.closures.yaml").write_text(closures)
    robot = Robot.load(tmp_path / "slides.urdf")
    poses = robot.at(np.zeros((1, 4)))
    if slope < 1e-6:
        with pytest.raises(SingularConfigurationError, match="locked at pose 0"):
            sensitivities(GeometricErrors(robot, []), poses)
    else:
        found = sensitivities(GeometricErrors(robot, []), poses).commands[0, :, 0]
        np.testing.assert_allclose(found, [1.0, 1.0 / slope, 0.0, 0.0, 0.0, 0.0], rtol=1e-12, atol=1e-12)


def test_frames_inside_frames_move_together() -> None:
    """Errors in the middle of a chain of fixed joints move everything beyond."""
    mechanism = Robot.load("pm3dof")
    parameters = [p for p in all_parameters(mechanism) if p.place.startswith("slider")]
    middle = [type(p)(**{**p.__dict__, "name": f"m.{p.name[-2:]}", "place": "middle_platform"}) for p in parameters[:6]]
    errors = GeometricErrors(mechanism, [*parameters, *middle])
    poses = mechanism.forward([[0.25, 0.22, 0.27]])
    values = errors.sample(np.random.default_rng(0)) * 10.0
    moved = errors.apply(values).forward(poses.commands, guess=poses.q)
    np.testing.assert_allclose(
        sensitivities(errors, moved, values).errors, _differences(errors, moved, values), atol=AGREEMENT
    )


@pytest.mark.usefixtures("programs_for_few_poses")
@pytest.mark.parametrize("robot", ["pm3dof", "hexapod", "three_rps"])
def test_the_program_is_the_careful_engine(robot: str) -> None:
    described = Robot.load(robot)
    poses = reachable_poses(described, 100, np.random.default_rng(7))
    errors = closable(GeometricErrors(described), poses)
    errors = GeometricErrors(described, errors.parameters[_some(errors)])
    for values in (errors.zeros, errors.sample(np.random.default_rng(8))):
        at = poses if not values.any() else errors.apply(values).forward(poses.commands, guess=poses.q)
        found, careful = (sensitivities(errors, at, values, engine=engine) for engine in ("program", "pinocchio"))
        np.testing.assert_allclose(found.errors, careful.errors, atol=1e-11)
        np.testing.assert_allclose(found.commands, careful.commands, atol=1e-11)
        assert not np.array_equal(found.errors, careful.errors)  # two ways round differently: it was not the same one


@pytest.mark.usefixtures("programs_for_few_poses")
@pytest.mark.parametrize("machine", ["four_rrr", "eight legs", "walker"])
def test_too_many_drives_give_way_by_least_squares(machine: str, tmp_path: Path) -> None:
    """Differences of poses at which the commands of a machine with errors are met best; and both engines."""
    drawings = {"eight legs": legs, "walker": walker}
    path = drawings[machine](8 if "legs" in machine else 4).write(tmp_path) if machine in drawings else None
    robot = Robot.load(path or MACHINES / machine)
    errors = closable(GeometricErrors(robot, all_parameters(robot)))
    middle = robot.home_coordinates
    widths = [0.02 * robot.characteristic_length if c.unit == "m" else 0.02 for c in robot.coordinates]
    poses = robot.solve(middle + np.random.default_rng(3).uniform(-1.0, 1.0, (20, len(middle))) * widths)
    found, careful = (sensitivities(errors, poses, engine=engine) for engine in ("program", "pinocchio"))
    np.testing.assert_allclose(found.errors, careful.errors, rtol=1e-8, atol=1e-10 * np.abs(careful.errors).max())
    np.testing.assert_allclose(found.commands, careful.commands, rtol=1e-8, atol=1e-10 * np.abs(careful.commands).max())
    few = poses[:2]
    for k in np.linspace(0, len(errors) - 1, 5).astype(int):
        step = 1e-6 * (np.arange(len(errors)) == k)
        ends = [errors.apply(sign * step).forward(few.commands, guess=few.q).transforms for sign in (1.0, -1.0)]
        slope = pose_difference(ends[1], ends[0]) / 2e-6
        np.testing.assert_allclose(found.errors[:2, :, k], slope, atol=1e-4 * np.abs(found.errors[:2]).max())
    step = 1e-6 * (np.arange(len(robot.commands)) == 1)
    ends = [robot.forward(few.commands + sign * step, guess=few.q).transforms for sign in (1.0, -1.0)]
    slope = pose_difference(ends[1], ends[0]) / 2e-6
    np.testing.assert_allclose(found.commands[:2, :, 1], slope, atol=1e-4 * np.abs(found.commands[:2]).max())


def test_a_sarrus_linkage_closes_with_all_errors_that_are_kept(tmp_path: Path) -> None:
    """Two crossed legs of three parallel hinges: rotating a hinge lets it close to first order at most.

    The errors kept leave the hinges of each leg parallel, for which any three do.
    """
    legs = [("0.1 0 0", "0.1 0 0.1", "-0.1 0 0.1", "0 1 0"), ("0 0.1 0", "0 0.1 0.1", "0 -0.1 0.1", "1 0 0")]
    parts = ['<link name="base"/>']
    for leg, (*places, axis) in enumerate(legs):
        for k, place in enumerate(places):
            parent, child = "base" if k == 0 else f"l{leg}{k - 1}", f"l{leg}{k}"
            parts.append(
                f'<link name="{child}"/><joint name="{child}" type="continuous"><parent link="{parent}"/>'
                f'<child link="{child}"/><origin xyz="{place}"/><axis xyz="{axis}"/></joint>'
            )
        offset = "-0.1 0 0" if leg == 0 else "0 -0.1 0"
        parts.append(
            f'<link name="top{leg}"/><joint name="f{leg}" type="fixed"><parent link="l{leg}2"/>'
            f'<child link="top{leg}"/><origin xyz="{offset}"/></joint>'
        )
    (tmp_path / "sarrus.urdf").write_text(f'<robot name="sarrus">{"".join(parts)}</robot>')
    (tmp_path / "sarrus.closures.yaml").write_text(
        "closed_loop: [[top0, top1]]\ntype: [6d]\nname_mot: [l00]\ntool_frame: top0\n"
    )
    robot = Robot.load(tmp_path)
    errors = closable(GeometricErrors(robot))
    assert {"l00.tx", "l01.tz", "l02.tx", "l10.ty", "l12.tz"} <= set(errors.names)
    for seed in range(3):
        crooked = errors.apply(errors.sample(np.random.default_rng(seed)))
        assert crooked.forward([[0.05], [-0.05], [0.1]], on_failure="nan").solved.all()


def test_what_closes_does_not_depend_on_the_size_of_errors() -> None:
    """Displacements by heat or clearance are given as effects of 1 m and 1 rad, with which no machine would close."""
    errors = GeometricErrors.load("hexapod")
    large = GeometricErrors(errors.robot, [dataclasses.replace(p, tolerance=1.0) for p in errors.parameters])
    assert closable(large).names == closable(errors).names == errors.names
