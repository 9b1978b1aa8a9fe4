"""Fixtures shared by several subpackages."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import io
import json
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

# as in the command: for small matrices, threads inside BLAS only compete
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["PM3DOF_ROBOT"] = "pm3dof"  # commands without --robot do not say each time that they are about it

import numpy as np
import pytest

if TYPE_CHECKING:
    from pm3dof_pin.chapter import Tripod
    from pm3dof_pin.errors.error_parameters import GeometricErrors
    from pm3dof_pin.kinematics.poses import Poses
    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.maps.workspace import Workspace


gc.disable()  # during collection, which makes no garbage


def pytest_collection_finish() -> None:
    """Exclude modules and tests from garbage collection, and run it less often: it took a tenth of the total time."""
    gc.freeze()
    gc.set_threshold(10_000, 20, 50)
    gc.enable()


_OURS = (b"PM3DOF_", b"ROS_", b"HOME", b"PATH", b"MPL", b"PYTHONPATH", b"XDG_")  # libraries may change others


def _state() -> dict[str, Any]:
    """Process-wide state that a test may change; pytest restores warning filters."""
    from pm3dof_pin.description import expand

    return {
        "folder": os.getcwd(),
        "environment": {name: value for name, value in os.environb.items() if name.startswith(_OURS)},
        "arguments": list(sys.argv),
        "signals": [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)],
        "handlers of logs": list(logging.getLogger("pm3dof_pin").handlers),
        "errors of numbers": np.geterr(),
        "trust in xacro": expand.is_xacro_trusted(),
        # thread pools are kept for the next program
        "threads": {t for t in threading.enumerate() if not t.daemon and not t.name.startswith("ThreadPool")},
    }


def _levels() -> dict[str, int]:
    loggers = logging.Logger.manager.loggerDict.items()
    return {
        name: log.level for name, log in loggers if name.startswith("pm3dof_pin") and isinstance(log, logging.Logger)
    }


@pytest.fixture(autouse=True)
def _nothing_left_behind() -> Iterator[None]:
    """Fail a test that changes process-wide state; restore log levels, which a command may set."""
    before, levels, matplotlib = _state(), _levels(), sys.modules.get("matplotlib")
    style = dict.copy(matplotlib.rcParams) if matplotlib else None  # without checking each item
    yield
    for name in _levels():
        if logging.getLogger(name).level != levels.get(name, logging.NOTSET):  # setting it clears all loggers' caches
            logging.getLogger(name).setLevel(levels.get(name, logging.NOTSET))
    for name, now in _state().items():
        assert now == before[name], f"the test leaves another {name}"
    assert matplotlib is None or dict.copy(matplotlib.rcParams) == style, "the test leaves another style of pictures"


@dataclasses.dataclass(frozen=True)
class Done:
    """Result of a command: its exit status and output."""

    returncode: int
    stdout: str
    stderr: str


def run_command(*arguments: str, cwd: Path | None = None, merged: bool = False) -> Done:
    """Run `pm3dof` in this process, which saves the imports.

    Args:
        arguments: as on the command line.
        cwd: folder to run it in.
        merged: whether `stdout` includes the messages, as on a terminal.
    """
    from pm3dof_pin.cli.app import main

    stdout, status = io.StringIO(), 0
    stderr = stdout if merged else io.StringIO()
    argv, sys.argv = sys.argv, ["pm3dof", *arguments]
    try:
        with (
            contextlib.redirect_stdout(stdout),
            contextlib.redirect_stderr(stderr),
            contextlib.chdir(cwd or Path.cwd()),
        ):
            main()
    except SystemExit as leaving:
        status = leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
    finally:
        sys.argv = argv
    return Done(status, stdout.getvalue(), "" if merged else stderr.getvalue())


@pytest.fixture(scope="session")
def run() -> Callable[..., Done]:
    """Run `pm3dof`: see :func:`run_command`."""
    return run_command


@pytest.fixture(scope="session")
def answer() -> Callable[..., dict[str, Any]]:
    """Run `pm3dof` with --json, check its exit status, and return its answer."""

    def read(*arguments: str, status: int = 0, cwd: Path | None = None) -> dict[str, Any]:
        done = run_command(*arguments, "--json", cwd=cwd)
        assert done.returncode == status, done.stderr
        return json.loads(done.stdout)

    return read


@pytest.fixture(scope="session")
def calibration_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a calibration of a simulated tripod; tests leave it as it is."""
    import pm3dof_pin as pm

    errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(1)
    machine = pm.SimulatedMachine.random(errors, generator, everything=False)
    commands = pm.reachable_poses(errors.robot, 40, generator).commands
    rows = pm.Measurements.from_poses(commands, machine.measure(commands, generator))
    return pm.calibrate(rows, errors, "lm").save(tmp_path_factory.mktemp("signed") / "calibration")


@pytest.fixture(scope="session", autouse=True)
def _coarse_pictures() -> Iterator[None]:
    """Render at lower resolution, in half the time; tests/figures renders at full resolution."""
    from pm3dof_pin.figures import outlined_mesh, style

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "DPI", 100)
        patch.setattr(outlined_mesh, "_CELLS", 30)
        yield


@pytest.fixture
def unpainted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make figures and their files without rendering; other tests check pictures."""
    monkeypatch.setattr("pm3dof_pin.figures.style._paint", lambda figure, path, *_: path.touch())


@pytest.fixture
def report_without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Omit the pictures of a calibration report and most poses of its maps, which take half of its time."""
    from matplotlib.figure import Figure

    from pm3dof_pin.calibration import report, workspace_errors

    names = ("tip_error_validation", "tip_error_held_out", "residuals", "workspace", "parameters")
    monkeypatch.setattr(report, "calibration_pictures", lambda *_, **__: dict.fromkeys(names, Figure()))
    monkeypatch.setattr(report, "html_image", lambda figure, text: f"<p>{text}</p>")
    monkeypatch.setattr(workspace_errors, "_POINTS", 7)


@pytest.fixture(scope="module")
def few_folds() -> Iterator[None]:
    """Hide measurements by thirds instead of fifths where how good a calibration is, is not the question."""
    from pm3dof_pin.calibration import held_out

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(held_out, "_FOLDS", 3)
        yield


@pytest.fixture(scope="session")
def tripod() -> Tripod:
    """The chapter's machine in closed form."""
    from pm3dof_pin.chapter import Tripod

    return Tripod.load()


@pytest.fixture(scope="session")
def hollow_tripod(tripod: Tripod) -> Tripod:
    """A machine whose sections are not all star-shaped.

    Long links, a short stroke and joints under the platform: tilted, it reaches lower than level.
    """
    from pm3dof_pin.chapter import Tripod

    return Tripod(
        dataclasses.replace(
            tripod.parameters,
            link_length=0.416,
            platform_radius=0.088,
            platform_joint_height=-0.083,
            guide_slope=1.1,
            slider_home=0.23,
            slider_stroke=0.036,
            spherical_limit=1.2,
            spherical_axis_inclination=1.0,
            universal_limit=1.32,
        )
    )


@pytest.fixture(scope="session")
def mechanism() -> Robot:
    """The chapter's machine from its URDF and closures file."""
    from pm3dof_pin.kinematics.robot import Robot

    return Robot.load("pm3dof")


@pytest.fixture(scope="session")
def rigid_in_shear() -> Callable[..., Robot]:
    """Give a tripod the chapter's passive leg, a beam that does not shear, and other keys of its spring."""

    def changed(robot: Robot, **keys: Any) -> Robot:
        own = {"shear_stiffness": "rigid"} | keys
        springs = [dict(entry) | (own if entry["name"] == "passive_leg" else {}) for entry in robot.springs]
        return robot.replace(springs=springs)

    return changed


@pytest.fixture(scope="session")
def slender(mechanism: Robot, rigid_in_shear: Callable[..., Robot]) -> Robot:
    """The chapter's machine as the chapter models it: its passive leg does not shear."""
    return rigid_in_shear(mechanism)


@pytest.fixture(scope="session")
def tripod_workspace(tripod: Tripod) -> Workspace:
    """The whole reachable set of the chapter's machine, 61 sections of 90 rays."""
    from pm3dof_pin.maps.chapter_workspace import tripod_space
    from pm3dof_pin.maps.workspace import workspace

    return workspace(tripod_space(tripod), 61, 90)


@pytest.fixture(scope="session")
def reachable_poses(tripod: Tripod) -> np.ndarray:
    """10,000 random poses within every joint limit, shape=(10000, 3) [rad, rad, m]."""
    from pm3dof_pin.chapter.limits import limit_flags

    generator = np.random.default_rng(20100801)
    lowest, highest = np.array([-0.8, -0.8, 0.38]), np.array([0.8, 0.8, 0.6])
    candidates = generator.uniform(lowest, highest, (45_000, 3))
    reachable = candidates[limit_flags(tripod, candidates) == 0]
    assert len(reachable) >= 10_000
    return reachable[:10_000]


FOUR_BAR = """<robot name="four_bar">
<link name="ground"/><link name="crank"/><link name="coupler"/><link name="rocker"/>
<link name="coupler_tip"/><link name="rocker_tip"/><link name="pen"/>
{joints}
</robot>
"""
REVOLUTE = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0" rpy="0 0 {yaw}"/><axis xyz="0 0 1"/><limit lower="-3.2" upper="3.2" effort="1" velocity="1"/>
</joint>"""
FIXED = """<joint name="{child}_fixed" type="fixed"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} {y} 0" rpy="0 0 {yaw}"/></joint>"""
CLOSURES = "closed_loop: [[coupler_tip, rocker_tip]]\ntype: ['3d']\nname_mot: [crank_joint]\ntool_frame: pen\n"


@pytest.fixture(scope="session")
def tripod_errors() -> GeometricErrors:
    """The chapter's machine with the 40 error parameters of its file."""
    from pm3dof_pin.errors.error_parameters import GeometricErrors

    return GeometricErrors.load("pm3dof")


@pytest.fixture(scope="session")
def redundant_errors(tripod_errors: GeometricErrors) -> GeometricErrors:
    """The same with one without effect on the tool: a rotation about the axis of a passive joint."""
    from pm3dof_pin.errors.error_parameters import GeometricErrors

    everything = GeometricErrors(tripod_errors.robot)
    turn = everything.select(["platform_x_joint.rx"]).parameters
    return GeometricErrors(tripod_errors.robot, [*tripod_errors.parameters, *turn])


@pytest.fixture(scope="session")
def tripod_nominal(tripod_errors: GeometricErrors, reachable_poses: np.ndarray) -> Poses:
    """300 poses within all limits."""
    return tripod_errors.robot.solve(reachable_poses[:300])


@pytest.fixture(scope="session")
def four_bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A parallelogram four-bar with a pen on its coupler; q = 0 is assembled."""
    joints = [
        REVOLUTE.format(name="crank_joint", parent="ground", child="crank", x=0.0, yaw=np.radians(80)),
        REVOLUTE.format(name="coupler_joint", parent="crank", child="coupler", x=0.3, yaw=-np.radians(80)),
        REVOLUTE.format(name="rocker_joint", parent="ground", child="rocker", x=0.6, yaw=np.radians(80)),
        FIXED.format(parent="coupler", child="coupler_tip", x=0.6, y=0.0, yaw=0.0),
        FIXED.format(parent="rocker", child="rocker_tip", x=0.3, y=0.0, yaw=0.0),
        FIXED.format(parent="coupler", child="pen", x=0.25, y=0.1, yaw=0.4),
    ]
    path = tmp_path_factory.mktemp("four_bar") / "four_bar.urdf"
    path.write_text(FOUR_BAR.format(joints="\n".join(joints)))
    path.with_suffix(".closures.yaml").write_text(CLOSURES)
    return path


@pytest.fixture(scope="session")
def six_rods(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six arms on motors of the base carry a platform by rods that are closures of type "distance", 0.33 m long."""
    tag = '<link name="{1}"/><joint name="{2}" type="{3}"><parent link="{0}"/><child link="{1}"/>{4}</joint>'
    text, limit = '<robot name="six_rods"><link name="base"/>', '<limit lower="-0.6" upper="0.6"/>'
    carrier, place = "base", '<origin xyz="0 0 0.25"/>'
    for joint, kind, axis in zip(
        ("x", "y", "z", "rx", "ry", "rz"),
        3 * ["prismatic"] + 3 * ["revolute"],
        2 * ["1 0 0", "0 1 0", "0 0 1"],
        strict=True,
    ):
        link = "platform" if joint == "rz" else f"{joint}_link"
        text += tag.format(carrier, link, joint, kind, f'{place}<axis xyz="{axis}"/>{limit}')
        carrier, place = link, ""
    lengths = []
    for k, (foot, ball) in enumerate(np.radians([[-15, -50], [15, 50], [105, 70], [135, 170], [225, 190], [255, 290]])):
        base, out = np.array([0.2 * np.cos(foot), 0.2 * np.sin(foot), 0.0]), np.array([np.cos(foot), np.sin(foot), 0.0])
        end = np.array([0.1 * np.cos(ball), 0.1 * np.sin(ball), 0.0])
        lengths.append(float(np.linalg.norm(end - base - 0.1 * out + (0.0, 0.0, 0.25))))
        numbers = ['xyz="{} {} {}"'.format(*map(repr, vector.tolist())) for vector in (base, end)]
        turned = f'<origin {numbers[0]} rpy="{np.pi / 2} 0 {float(foot)!r}"/><axis xyz="0 0 1"/>{limit}'
        text += tag.format("base", f"arm{k}", f"m{k}", "revolute", turned)
        text += tag.format(f"arm{k}", f"tip{k}", f"tip{k}_fixed", "fixed", '<origin xyz="0.1 0 0"/>')
        text += tag.format("platform", f"ball{k}", f"ball{k}_fixed", "fixed", f"<origin {numbers[1]}/>")
    path = tmp_path_factory.mktemp("six_rods") / "six_rods.urdf"
    path.write_text(text + "</robot>")
    path.with_suffix(".closures.yaml").write_text(
        f"closed_loop: [{', '.join(f'[tip{k}, ball{k}]' for k in range(6))}]\ntype: [{', '.join(6 * ['distance'])}]\n"
        f"closure_lengths: {lengths}\nname_mot: [m0, m1, m2, m3, m4, m5]\ntool_frame: platform\n"
    )
    return path


@pytest.fixture(scope="session")
def serial_arm() -> Robot:
    """A UR5, without description files of its own."""
    import example_robot_data

    from pm3dof_pin.kinematics.robot import Robot

    return Robot(example_robot_data.load("ur5").model, tool_frame="tool0")


@pytest.fixture(scope="session")
def cases(tripod_errors: GeometricErrors, four_bar: Path, serial_arm: Robot) -> dict[str, Poses]:
    """A few nominal poses of every robot, by name."""
    from pm3dof_pin.kinematics.robot import Robot

    rng = np.random.default_rng(1)
    hexapod, bar = Robot.load("hexapod"), Robot.load(four_bar)
    commands = {
        "tripod": (tripod_errors.robot, 0.240272 + rng.uniform(-0.03, 0.03, (4, 3))),
        "hexapod": (hexapod, hexapod.home.commands + rng.uniform(-0.003, 0.003, (4, 6))),
        "four_bar": (bar, rng.uniform(-0.4, 0.4, (4, 1))),
        "serial": (serial_arm, rng.uniform(-2.0, 2.0, (4, 6))),
    }
    return {name: robot.forward(values) for name, (robot, values) in commands.items()}


@pytest.fixture(scope="session", params=["tripod", "hexapod", "four_bar", "serial"])
def case(request: pytest.FixtureRequest, cases: dict[str, Poses]) -> Poses:
    """Poses of one robot of :func:`cases` after the other."""
    poses: Poses = cases[request.param]
    return poses


@pytest.fixture
def programs_for_few_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let programs compute the few poses for which Pinocchio would be as fast."""
    from pm3dof_pin.dynamics import batch, dynamic_stiffness, motion_dynamics, motion_forces
    from pm3dof_pin.errors import error_sums, sensitivity
    from pm3dof_pin.kinematics import jacobians

    for module in (batch, sensitivity):
        monkeypatch.setattr(module, "_PROGRAM_FROM", 0)
    for module in (dynamic_stiffness, motion_dynamics, motion_forces, error_sums, jacobians):
        monkeypatch.setattr(module, "PROGRAM_FROM", 0)
