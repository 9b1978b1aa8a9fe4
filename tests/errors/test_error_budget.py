"""Sources of error, separate and together: against simulated machines with one source each, and Monte Carlo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import scipy.spatial
import scipy.special

from pm3dof_pin.description.schema import checked
from pm3dof_pin.description.source_numbers import SourceNumbers
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.errors import source_errors
from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.errors.error_budget import TOGETHER, ErrorBudget, error_budget
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors, declared_numbers
from pm3dof_pin.errors.normal_vectors import expected_norm
from pm3dof_pin.errors.pose_error import energy, moved_pose, pose_difference, tip_error, tip_weights
from pm3dof_pin.errors.sensitivity import Sensitivities, sensitivities
from pm3dof_pin.errors.source_errors import ErrorSources, SourceErrors
from pm3dof_pin.errors.waviness import GuideWaviness
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.simulation.simulated_machine import Conditions, MachineDrift, SimulatedMachine

WRENCH = np.array([200.0, -100.0, -300.0, 5.0, -3.0, 2.0])
NUMBERS = {
    "drives": {"servo_stiffness_N_per_m": 1e8, "servo_stiffness_Nm_per_rad": 1e5},
    "vibration": {"tool": None, "motors": None, "axes": None},
}


def sources_of(name: str, **numbers: object) -> ErrorSources:
    errors = GeometricErrors.load(name)
    return ErrorSources(errors, checked(NUMBERS | numbers, SourceNumbers, "numbers"), wrench=WRENCH)


@pytest.fixture(scope="module", params=["pm3dof", "hexapod"])
def case(request: pytest.FixtureRequest) -> tuple[ErrorSources, Poses, dict[str, SourceErrors]]:
    """The sources of a robot at some poses, by name."""
    frames = {"pm3dof": ("E1", "E2"), "hexapod": ("P1", "P2")}[request.param]
    robot = Robot.load(request.param)
    known = [frame for frame in frames if robot.model.existFrame(frame)] or [robot.closures[0].frame_b]
    sources = sources_of(request.param, clearance={"at": known, "play_m": 1e-5})
    poses = reachable_poses(sources.robot, 6, np.random.default_rng(0))
    return sources, poses, {source.name: source for source in sources.at(poses)}


def moved(machine: SimulatedMachine, poses: Poses, conditions: Conditions | None = None) -> np.ndarray:
    return pose_difference(poses.transforms, machine.poses(poses.commands, conditions))


Case = tuple[ErrorSources, Poses, dict[str, SourceErrors]]


def test_growth_is_that_of_the_simulated_machine(case: Case) -> None:
    """One kelvin for all, then for one screw against the mean of all: members grow only with the mean."""
    sources, poses, found = case
    machine = SimulatedMachine(sources.robot, thermal=sources.thermal_growth)
    rises, drives = np.array([[10.0]]), len(sources.robot.commands)
    seen = moved(machine, poses, Conditions(rises)) / 10.0
    per_kelvin = found["thermal_growth"].effects[:, :, 0] / (8.0 / np.sqrt(3.0))
    np.testing.assert_allclose(seen, per_kelvin, atol=2e-3 * np.abs(per_kelvin).max())
    first = np.zeros(drives)
    first[0] = 10.0
    apart = moved(machine, poses, Conditions(first - first.mean())) / 10.0
    column = found["thermal_gradient"].effects[:, :, 0] / (2.0 / np.sqrt(3.0))
    np.testing.assert_allclose(apart, column, atol=2e-3 * np.abs(column).max())


@pytest.mark.parametrize(("name", "place"), [("pm3dof", "platform_x_joint"), ("hexapod", "O_e"), ("three_rps", "O_e")])
def test_bent_members_are_those_of_the_simulated_machine(name: str, place: str) -> None:
    """2 K across a member 30 mm deep and 110 mm long, in both directions: with and without bending."""
    thermal = {"across_K": 0.5, "bending": {place: {"depth_m": 0.03, "along_m": [0.0, 0.0, 0.11]}}}
    sources = sources_of(name, thermal=thermal)
    poses = reachable_poses(sources.robot, 5, np.random.default_rng(0))
    bent = {source.name: source for source in sources.at(poses, ["thermal"])}["thermal_bending"]
    growth = sources.thermal_growth
    machines = (SimulatedMachine(sources.robot, thermal=g) for g in (growth, replace(growth, bending={})))
    with_bend, without = (machine.poses(poses.commands, Conditions(2.0)) for machine in machines)
    seen = pose_difference(without, with_bend) / 2.0
    per_kelvin = bent.effects.sum(axis=2) / (0.5 / np.sqrt(3.0))
    np.testing.assert_allclose(seen, per_kelvin, atol=2e-3 * np.abs(per_kelvin).max())


def test_links_between_two_joints_bend_without_a_trace() -> None:
    """Struts with axial loads only: their ends rotate about their joints, whichever way they bend."""
    sources = sources_of("hexapod", thermal={"bending": {f"strut{k}_tip": {"depth_m": 0.02} for k in range(1, 7)}})
    poses = reachable_poses(sources.robot, 5, np.random.default_rng(0))
    assert "thermal_bending" not in {source.name for source in sources.at(poses, ["thermal"])}


def test_drift_is_that_of_the_simulated_machine_and_stays(case: Case) -> None:
    """One zero, then warming, after five hours; over a job the rms is that of random rates and times."""
    stated = {"hours": 8.0, "warming_K_per_h": 0.5, "zeros_m_per_h": 2e-7, "zeros_rad_per_h": 2e-6}
    sources, poses, _ = case
    sources = sources_of(sources.robot.name, drift=stated)
    budget = error_budget(sources, poses, names=["thermal_drift", "drift"])
    found = {source.name: source for source in budget.sources}
    first = np.eye(poses.commands.shape[1])[0]
    for name, machine, scatter in (
        ("drift", SimulatedMachine(sources.robot, drift=MachineDrift(1e-6 * first)), 2e-7 / 1e-6),
        (
            "thermal_drift",
            SimulatedMachine(sources.robot, thermal=sources.thermal_growth, drift=MachineDrift(0.0 * first, 0.5)),
            1.0,
        ),
    ):
        seen = moved(machine, poses, Conditions(hours=5.0))
        rates, hours = np.linspace(-1.0, 1.0, 2001), np.linspace(0.0, 8.0, 2001)
        rms = np.sqrt(np.mean(rates**2) * np.mean(hours**2)) / 5.0
        column = found[name].effects[:, :, 0]
        np.testing.assert_allclose(scatter * rms * seen, column, atol=3e-3 * np.abs(column).max())
        assert found[name].greatest[0] * rms == pytest.approx(8.0 / 5.0, rel=2e-3)
    np.testing.assert_allclose(budget.left_rms, budget.tip_rms)


def test_deflections_are_those_of_the_simulated_machine(case: Case) -> None:
    sources, poses, found = case
    machine = SimulatedMachine(sources.robot, elastic=ElasticDeflection())
    seen = moved(machine, poses, Conditions(wrenches=WRENCH))
    np.testing.assert_allclose(seen, found["weight"].shift + found["wrench"].shift, atol=1e-6 * np.abs(seen).max())


def test_waves_scatter_as_drawn_ones(case: Case) -> None:
    """The variance over 800 guideways of random waves, along the drives."""
    sources, poses, found = case
    drives, generator = len(sources.robot.commands), np.random.default_rng(0)
    offsets = [command.offset for command in sources.robot.commands]
    drawn = [GuideWaviness.random(drives, generator).travel_errors(poses.commands - offsets) for _ in range(800)]
    along = found["waviness"].effects[:, :, :drives]
    commands = np.linalg.lstsq(found["backlash"].effects[0] / 1e-6, along[0], rcond=None)[0]
    np.testing.assert_allclose(np.std(drawn, axis=0), abs(commands[0, 0]), rtol=0.1)
    assert found["waviness"].greatest[0] * commands[0, 0] == pytest.approx(3 * 3e-6)


def test_drives_that_stand_beside_their_command(case: Case) -> None:
    """The robot itself with one drive off by half the backlash; a uniform encoder step has s / sqrt(12)."""
    sources, poses, found = case
    scale = sources.robot.commands[0].scale
    off = poses.commands + scale * 1e-6 * np.eye(poses.commands.shape[1])[0]
    seen = pose_difference(poses.transforms, sources.robot.forward(off, guess=poses.q).transforms)
    np.testing.assert_allclose(seen, found["backlash"].effects[:, :, 0], atol=1e-3 * np.abs(seen).max())
    np.testing.assert_allclose(seen / np.sqrt(12.0), found["encoder"].effects[:, :, 0], atol=1e-3 * np.abs(seen).max())


def test_servos_give_way_as_springs_at_the_drives_would(case: Case) -> None:
    """With rigid links and the wrench alone: C = J diag(1 / k) J^T, J by finite differences of the commands."""
    sources, poses, _ = case
    loads = {"load": {"own_weight": False}}
    servo = {s.name: s for s in sources_of(sources.robot.name, **loads).at(poses)}["servo"]
    compliance = np.zeros((len(poses), 6, 6))
    for k, unit in enumerate(np.eye(poses.commands.shape[1])):
        ends = [
            sources.robot.forward(poses.commands + sign * 1e-5 * sources.robot.commands[k].scale * unit, guess=poses.q)
            for sign in (1.0, -1.0)
        ]
        column = pose_difference(ends[1].transforms, ends[0].transforms) / 2e-5
        compliance += np.einsum("ni,nj->nij", column, column) / 1e8
    np.testing.assert_allclose(servo.shift, compliance @ WRENCH, atol=1e-4 * np.abs(servo.shift).max())


def test_clearance_moves_a_joint_within_its_play(case: Case) -> None:
    """A closure point off by the full clearance: the loops of a robot with this geometric error are closed."""
    sources, poses, found = case
    names = [p.name for p in sources.others.parameters if p.group == "clearance"]
    assert len(names) in (3, 6)
    k = names.index(names[0])
    crooked = GeometricErrors(sources.robot, sources.others.parameters).apply({names[0]: 1e-5})
    seen = pose_difference(poses.transforms, crooked.forward(poses.commands, guess=poses.q).transforms)
    expected = found["clearance"].effects[:, :, k] * found["clearance"].greatest[k]
    np.testing.assert_allclose(seen, expected, atol=1e-3 * np.abs(seen).max())


def test_large_deflections_are_those_of_the_loaded_equilibrium() -> None:
    sources = ErrorSources(GeometricErrors.load("pm3dof"), wrench=[3e4, 0, 0, 0, 0, 0], large=True)
    poses = reachable_poses(sources.robot, 2, np.random.default_rng(0))
    small = {s.name: s for s in ErrorSources(sources.errors, wrench=sources.wrench).at(poses)}
    found = {s.name: s for s in sources.at(poses)}
    model = ElasticModel(sources.robot)
    for row, q in enumerate(poses.q):
        loads = Loads({"O_e": sources.wrench}, own_weight=True)
        expected = loaded_equilibrium(model, q, loads).displacement()
        np.testing.assert_allclose(found["weight"].shift[row] + found["wrench"].shift[row], expected, rtol=1e-9)
    difference = np.linalg.norm((found["wrench"].shift - small["wrench"].shift)[:, :3], axis=1)
    assert np.all(difference > 1e-3 * np.linalg.norm(small["wrench"].shift[:, :3], axis=1))


@pytest.fixture(scope="module")
def budget(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> ErrorBudget:
    return error_budget(ErrorSources(tripod_errors, wrench=WRENCH), tripod_nominal[:12])


def test_geometry_alone_is_the_error_map(budget: ErrorBudget, tripod_errors: GeometricErrors) -> None:
    mapped = error_map(tripod_errors, budget.poses)
    alone = budget.select([name for name in budget.names if name.startswith("geometry")])
    np.testing.assert_allclose(alone.tip_rms, mapped.tip_rms, rtol=1e-12)
    np.testing.assert_allclose(alone.left_rms, mapped.uncompensable_rms, rtol=1e-9)
    np.testing.assert_allclose(alone.worst_tip, mapped.worst_tip, rtol=1e-12)
    np.testing.assert_allclose(alone.energy, mapped.energy, rtol=1e-12)
    assert set(budget.select(["kinematic parameters"]).names) == {*alone.names, "waviness"}
    with pytest.raises(InvalidValueError, match="thermal_growth"):
        budget.select(["heat"])


def test_sensitivities_that_are_known_are_not_computed_again(
    tripod_errors: GeometricErrors, tripod_nominal: Poses, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources, poses = ErrorSources(tripod_errors), tripod_nominal[:5]
    expected, found = error_budget(sources, poses), sensitivities(tripod_errors, poses)

    def others_only(errors: GeometricErrors, *arguments: Poses) -> Sensitivities:
        assert errors is sources.others
        return sensitivities(errors, *arguments)

    monkeypatch.setattr(source_errors, "sensitivities", others_only)
    budget = error_budget(sources, poses, found=found)
    np.testing.assert_allclose(budget.tip_rms, expected.tip_rms, rtol=1e-12)
    np.testing.assert_allclose(budget.left_rms, expected.left_rms, rtol=1e-9)


def test_rms_energy_and_worst_case_against_machines_drawn(budget: ErrorBudget) -> None:
    """Normal numbers for the statistics, numbers within their greatest values for the bound."""
    generator, machines = np.random.default_rng(0), 20_000
    numbers = generator.standard_normal((machines, budget.effects.shape[2]))
    drawn = budget.shift + np.einsum("nik,mk->mni", budget.effects, numbers)
    tip = tip_error(drawn)
    np.testing.assert_allclose(np.sqrt(np.mean(tip**2, axis=0)), budget.tip_rms, rtol=0.01)
    there = moved_pose(budget.poses.transforms, drawn[:2000])
    np.testing.assert_allclose(energy(budget.poses.transforms, there).mean(axis=0), budget.energy, rtol=0.03)
    greatest = np.concatenate([source.greatest for source in budget.sources])
    extremes = budget.shift + np.einsum("nik,mk->mni", budget.effects, greatest * np.sign(numbers))
    assert np.all(tip_error(extremes) <= budget.worst_tip)
    weighted = budget.effects * tip_weights()[:, None]
    along = np.einsum("nik,nil->nkl", weighted, weighted)  # a corner that leans towards the largest column
    corner = np.sign(along[np.arange(12), np.argmax(np.einsum("nkk->nk", along), axis=1)]) * greatest
    reached = np.abs(np.einsum("nik,nk->ni", weighted, corner))
    assert np.all(np.linalg.norm(reached, axis=1) > 0.3 * budget.worst_tip)


def test_what_commands_leave(budget: ErrorBudget) -> None:
    """Least squares for the shift, by np.linalg.lstsq; errors that do not repeat remain in full."""
    wrench = budget.select(["wrench"])
    weights = tip_weights()[:, None]
    for row in range(3):
        control, error = budget.control[row] * weights, wrench.shift[row] * weights[:, 0]
        left = error - control @ np.linalg.lstsq(control, error, rcond=None)[0]
        assert wrench.left_rms[row] == pytest.approx(np.linalg.norm(left), rel=1e-9)
    shaking = budget.select(["vibration", "backlash"])
    np.testing.assert_allclose(shaking.left_rms, shaking.tip_rms, rtol=1e-12)


def test_the_lines_add_up(budget: ErrorBudget) -> None:
    lines = budget.lines()
    assert [line.name for line in lines] == [*budget.names, TOGETHER]
    assert sum(line.share for line in lines[:-1]) == pytest.approx(1.0)
    random = [line for line in lines[:-1] if line.name not in ("weight", "wrench")]
    known = budget.select(["weight", "wrench"])
    squares = sum(line.tip_rms**2 for line in random) + np.mean(known.tip_rms**2)
    assert lines[-1].tip_rms == pytest.approx(np.sqrt(squares))
    least = budget.least_sensitive(0.25)
    assert least.sum() == 3
    assert budget.tip_rms[least].max() <= budget.tip_rms[~least].min()


def test_mean_lengths_of_normal_vectors() -> None:
    """B. Carlson's R_G is the mean of sqrt(sum s_i u_i^2) over the sphere (DLMF 19.16.3), E chi_3 = 2 sqrt(2 / pi)."""
    spread = np.array([1e-12, 4e-11, 3e-10])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    expected = 2.0 * np.sqrt(2.0 / np.pi) * scipy.special.elliprg(*spread)
    for mean in (np.zeros(3), np.full(3, 1e-14)):  # the second by the integral
        assert expected_norm(mean, turn @ np.diag(spread) @ turn.T) == pytest.approx(expected, rel=1e-9)
    assert expected_norm([3e-6, 0.0, 4e-6], np.zeros((3, 3))) == pytest.approx(5e-6, rel=1e-9)
    assert expected_norm(np.zeros(3), np.zeros((3, 3))) == 0.0
    # along one axis with a mean: the folded normal distribution
    folded = np.sqrt(2.0 / np.pi) * np.exp(-0.5) + (1.0 - 2.0 * scipy.special.ndtr(-1.0))
    assert expected_norm([1.0, 0.0, 0.0], np.diag([1.0, 0.0, 0.0])) == pytest.approx(folded, rel=1e-9)


def test_numbers_of_the_file(tmp_path: object, tripod_errors: GeometricErrors) -> None:
    assert declared_numbers(tripod_errors.robot).thermal.expansion_per_K == 11.5e-6
    bad = [
        ({"termal": {}}, "termal"),
        ({"drives": {"backlash_m": -1e-6}}, "backlash_m"),
        ({"vibration": {"tool": {"edges_Hz": [2.0, 1.0], "levels": [1.0]}}}, "increasing"),
        ({"vibration": {"damping": 1.0}}, "damping"),
        ({"load": {"wrench": [1.0, 2.0]}}, "wrench"),
    ]
    for data, words in bad:
        with pytest.raises(DescriptionError, match=words):
            checked(data, SourceNumbers, "file")
    with pytest.raises(InvalidValueError, match="wrench"):
        ErrorSources(tripod_errors, wrench=[1.0, np.nan, 0, 0, 0, 0])


@pytest.mark.parametrize("large", [False, True])
def test_a_payload_is_a_dead_force(tripod_nominal: Poses, large: bool) -> None:
    """A mass at the tool point deflects as its weight does."""
    weight = np.tile([0.0, 0.0, -9.81 * 40.0, 0.0, 0.0, 0.0], (2, 1))
    loaded = ElasticDeflection(own_weight=False, payload=40.0, large=large).displacements(tripod_nominal[:2])
    pulled = ElasticDeflection(own_weight=False, large=large).displacements(tripod_nominal[:2], weight)
    np.testing.assert_allclose(loaded, pulled, atol=1e-6 * np.abs(pulled).max())


def test_a_hexapod_stands_where_its_energy_is_least() -> None:
    """Struts as springs between points, k (l - l0)^2 / 2, minus the work of a force: minimised by SciPy."""
    robot = Robot.load("hexapod")
    poses = reachable_poses(robot, 1, np.random.default_rng(1))
    force = np.array([4e4, -3e4, -8e4])
    wrench = np.array([[*force, 0.0, 0.0, 0.0]])
    found = ElasticDeflection(own_weight=False, large=True).displacements(poses, wrench)[0]
    linear = ElasticDeflection(own_weight=False).displacements(poses, wrench)[0]
    there, tool = poses.configuration(0), poses.positions[0]
    feet = np.array([there.frame_placement(f"A{k}").translation for k in range(1, 7)])
    tops = np.array([there.frame_placement(f"B{k}").translation for k in range(1, 7)]) - tool
    rest = np.linalg.norm(tool + tops - feet, axis=1)
    stiffness = np.array([float(spring["stiffness"]) for spring in robot.springs])

    def potential(moved: np.ndarray) -> float:
        shift, turn = 1e-4 * moved[:3], scipy.spatial.transform.Rotation.from_rotvec(1e-3 * moved[3:])
        lengths = np.linalg.norm(tool + shift + turn.apply(tops) - feet, axis=1)
        return float(0.5 * stiffness @ (lengths - rest) ** 2 - force @ shift)

    least = scipy.optimize.minimize(potential, np.zeros(6), method="BFGS", options={"gtol": 1e-7})
    expected = least.x * np.repeat([1e-4, 1e-3], 3)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(found).max())
    assert np.abs(found - linear).max() > 0.01 * np.abs(found).max()
