"""Agreement of programs with Pinocchio: 10,000 random poses of every robot here, of test machines and hard variants.

Closing: values of the coordinates, and then of the commands, are drawn around home, over a box a quarter wider than the
one that poses within limits span, so that some are out of reach. The study compares which poses are found, which limits
they break, and the positions of all joints and the tool. Where the two engines found different poses, continuation from
home in legs of a hundredth of a radian, on Pinocchio's Jacobians, decides whose assembly mode is that of home.

Elasticity and sensitivities: at the poses that the program closed.

    python scripts/studies/agreement.py [NAME ...] [--poses N]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate
from pm3dof_pin.elastic.batch import evaluate, stiffness
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import COMPLIANCE, STIFFNESS
from pm3dof_pin.elastic.springs import AxialSpring, ClosureSpring, JointSpring
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable, sensitivities
from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.mobility import generic_configuration
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.tool_components import angle_rates, tool_components
from pm3dof_pin.typing import Array, Matrix, Vector

POSES = 10_000
MACHINES = Path(__file__).parents[2] / "tests" / "machines"
DESCRIPTIONS = {
    "pm3dof": "pm3dof",
    "hexapod": "hexapod",
    "three_rps": "three_rps",
    "delta": MACHINES / "delta",
    "five_bar": MACHINES / "five_bar",
    "three_rpr": MACHINES / "three_rpr",
    "four_bar": MACHINES / "four_bar",
    "linear_delta": "linear_delta",
    "ur5": "ur5",
    "walker": MACHINES / "walker" / "walker.xml",
}

_WIDER = 1.25
_WIDTH = 0.4  # of the box where no poses within limits can be found [rad, characteristic lengths]
_SAME = 1e-7  # difference up to which two poses are the same one, within rounding at a nearly singular pose
_LEG = 0.01  # legs of the continuation that decides on assembly modes [rad, characteristic lengths]
_ROUNDING = 1e-13  # difference that is not investigated further
_SINGULAR = 1e-9  # part of the greatest singular value that counts as zero
_SMOOTH = 20.0  # times as far as the coordinates a joint may go in one leg
_IDLE = 1e-3  # fraction of the greatest effect of an error that counts as the size of one with hardly any effect
_RIGID = 1e-12  # part of the softest direction that counts as rigid


def stiffer_spring(model: ElasticModel) -> ElasticModel:
    """Return the model with its first spring a million times stiffer."""
    springs = list(model.springs)
    k = next(k for k, spring in enumerate(springs) if isinstance(spring, (JointSpring, AxialSpring)))
    springs[k] = replace(springs[k], stiffness=1e6 * springs[k].stiffness)  # type: ignore[call-arg]
    return ElasticModel(model.rigid, springs)


def rigid_branches(model: ElasticModel) -> ElasticModel:
    """Return the model with its first spring only: all other branches are rigid."""
    return ElasticModel(model.rigid, model.springs[:1])


def giving_closures(model: ElasticModel) -> ElasticModel:
    """Return the model with an additional bushing in every closure."""
    generator = np.random.default_rng(5)
    bushings = []
    for k, closure in enumerate(model.rigid.closures):
        size = int(closure.type[0])
        root = np.sqrt(1e7) * (generator.uniform(-1.0, 1.0, (size, size)) + size * np.eye(size))
        root[3:] *= 0.1 * model.rigid.characteristic_length
        bushings.append(ClosureSpring(f"bushing{k}", k, root @ root.T))
    return ElasticModel(model.rigid, [*model.springs, *bushings])


VARIANTS: dict[str, tuple[str, Callable[[ElasticModel], ElasticModel]]] = {
    "pm3dof, a spring 1e6 times stiffer": ("pm3dof", stiffer_spring),
    "hexapod, a spring 1e6 times stiffer": ("hexapod", stiffer_spring),
    "pm3dof, branches without springs": ("pm3dof", rigid_branches),
    "pm3dof, springs in closures": ("pm3dof", giving_closures),
    "hexapod, springs in closures": ("hexapod", giving_closures),
    "three_rps, springs in closures": ("three_rps", giving_closures),
}


def load(name: str) -> Robot:
    """Load one of the robots of :data:`DESCRIPTIONS`."""
    return Robot.load(DESCRIPTIONS[name], tool_frame="tool0" if name == "ur5" else None)


@dataclass(frozen=True)
class Closing:
    """How two engines close loops at the same values.

    Attributes:
        poses: number of values.
        solved: number of poses that the program found.
        found_otherwise: number of poses that only one of the two found.
        other_mode: number of poses that both found, in different assembly modes.
        won: those of both kinds for which continuation in short legs ends where the program does, but the Pinocchio
            engine does not.
        lost: the reverse. All other continuations meet a singular pose.
        limits: number of common poses at which they differ on broken limits.
        difference: greatest difference of joints and tool at common poses [rad, characteristic lengths].
        refined: the same after one more Newton step of both on Pinocchio's Jacobians: the part not due to open loops.
        q: configurations that the program found.
    """

    poses: int
    solved: int
    found_otherwise: int
    other_mode: int
    won: int
    lost: int
    limits: int
    difference: float
    refined: float
    q: Matrix


def compared_closing(robot: Robot, coordinates: tuple[Coordinate, ...], count: int, seed: int = 0) -> Closing:
    """Close loops at random values of coordinates, which are the robot's or its commands, with both engines."""
    values = random_values(robot, coordinates, count, seed)
    solve = robot.solve if coordinates == robot.coordinates else robot.forward
    found, careful = (solve(values, on_failure="nan", engine=engine) for engine in ("program", "pinocchio"))
    differences = np.abs(places(robot, found.q) - places(robot, careful.q)).max(axis=1, initial=0.0)
    both = found.solved & careful.solved
    same = both & (differences < _SAME)
    otherwise = found.solved != careful.solved
    after = np.where(same, differences, 0.0)
    for row in np.flatnonzero(after > _ROUNDING):
        better = np.array([refined(robot, coordinates, q[row], values[row]) for q in (found.q, careful.q)])
        after[row] = np.abs(np.diff(places(robot, better), axis=0)).max()
    sides = [0, 0]
    for row in np.flatnonzero(otherwise | (both & ~same)):
        walked = places(robot, walk(robot, coordinates, values[row])[None])
        arrived = [np.abs(places(robot, q[row][None]) - walked).max() < _SAME for q in (found.q, careful.q)]
        for k in range(2):
            sides[k] += arrived[k] and not arrived[1 - k]
    return Closing(
        count,
        int(found.solved.sum()),
        int(otherwise.sum()),
        int((both & ~same).sum()),
        *sides,
        int((found.broken_limits != careful.broken_limits)[same].sum()),
        float(differences[same].max(initial=0.0)),
        float(after.max(initial=0.0)),
        found.q[found.solved],
    )


def random_values(robot: Robot, coordinates: tuple[Coordinate, ...], count: int, seed: int) -> Matrix:
    """Draw values of the coordinates around home, some of them out of reach."""
    home = robot.read(coordinates, robot.home.q, _transform(robot))
    width = np.array([_WIDTH * (robot.characteristic_length if c.unit == "m" else 1.0) for c in coordinates])
    lower, upper = home - width, home + width
    try:
        poses = reachable_poses(robot, 200, np.random.default_rng(0))
        inside = poses.coordinates if coordinates == robot.coordinates else poses.commands
        middle, half = 0.5 * (inside.max(axis=0) + inside.min(axis=0)), 0.5 * np.ptp(inside, axis=0)
        lower, upper = middle - _WIDER * half, middle + _WIDER * half
    except UnreachablePoseError:
        pass
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(home)))


def places(robot: Robot, q: Matrix) -> Matrix:
    """Return positions of joints, closure frames and the tool, in characteristic lengths; a rod may spin."""
    model, data = robot.model, robot.model.createData()
    frames = [robot.frame_id(name) for loop in robot.closures for name in (loop.frame_a, loop.frame_b)]
    rows = []
    for positions in q:
        pin.framesForwardKinematics(model, data, positions)  # NaN stays NaN
        tool = data.oMf[robot.tool_frame_id] if robot.tool_frame else pin.SE3.Identity()
        points = [data.oMi[k].translation for k in range(1, model.njoints)] + [data.oMf[k].translation for k in frames]
        rows.append(np.ravel([*points, tool.translation, *robot.characteristic_length * tool.rotation]))
    return np.array(rows) / robot.characteristic_length


def walk(robot: Robot, coordinates: tuple[Coordinate, ...], target: Vector) -> Vector:
    """Return where continuation from home in short legs ends; NaN if it meets a singular pose or fails."""
    home, q = robot.read(coordinates, robot.home.q, _transform(robot)), robot.home.q
    units = np.array([abs(c.scale) * (robot.characteristic_length if c.unit == "m" else 1.0) for c in coordinates])
    legs = max(1, int(np.ceil(np.abs((target - home) / units).max() / _LEG)))
    before = places(robot, q[None])
    rank = np.linalg.matrix_rank(equations(robot, coordinates, generic_configuration(robot.home).q), _SINGULAR)
    for leg in range(1, legs + 1):
        values = home + (target - home) * (leg / legs)
        numbers = [(value - c.offset) / c.scale for c, value in zip(coordinates, values, strict=True)]
        joints = {c.joint: n for c, n in zip(coordinates, numbers, strict=True) if c.joint is not None}
        tool = {c.tool: float(n) for c, n in zip(coordinates, numbers, strict=True) if c.tool is not None}
        result = assemble(robot, q, joints=joints, tool=tool)
        here = places(robot, result.configuration.q[None])
        smooth = result.converged and np.abs(here - before).max() <= _SMOOTH * _LEG
        q, before = result.configuration.q, here
        if not smooth or nearly_singular(equations(robot, coordinates, q), rank):
            return np.full(robot.model.nq, np.nan)
    return q


def equations(robot: Robot, coordinates: tuple[Coordinate, ...], q: Vector) -> Matrix:
    """Return Pinocchio's Jacobian of loop closures and tool placement with respect to the joints that are not given."""
    _, rows = robot.loop_kinematics.closures(q)
    rows = rows / robot.closure_scale[:, None]
    tool = [TOOL_COMPONENTS.index(c.tool) for c in coordinates if c.tool is not None]
    if tool:
        configuration = Configuration(robot, q)
        moved = configuration.tool_jacobian / np.repeat([robot.characteristic_length, 1.0], 3)[:, None]
        moved[3:] = angle_rates(tool_components(configuration.tool_placement.homogeneous)[3:]) @ moved[3:]
        rows = np.vstack([rows, moved[tool]])
    given = robot.velocity_indices([c.joint for c in coordinates if c.joint is not None])
    return np.delete(rows * robot.velocity_scale, given, axis=1)


def refined(robot: Robot, coordinates: tuple[Coordinate, ...], q: Vector, values: Vector) -> Vector:
    """Take the shortest Newton step on Pinocchio's Jacobians."""
    tool = [k for k, c in enumerate(coordinates) if c.tool is not None]
    units = np.array([robot.characteristic_length if coordinates[k].unit == "m" else 1.0 for k in tool])
    transform = Configuration(robot, q).tool_placement.homogeneous if tool else None
    left = (robot.read(coordinates, q, transform) - values)[tool] / units
    error = np.concatenate([robot.loop_kinematics.closures(q)[0] / robot.closure_scale, left])
    move = -np.linalg.pinv(equations(robot, coordinates, q), rcond=_SINGULAR) @ error
    given = robot.velocity_indices([c.joint for c in coordinates if c.joint is not None])
    free = np.delete(np.arange(robot.model.nv), given)
    velocity = np.zeros(robot.model.nv)
    velocity[free] = robot.velocity_scale[free] * move
    return np.asarray(pin.integrate(robot.model, q, velocity))


def nearly_singular(matrix: Matrix, rank: int) -> bool:
    """Tell whether a matrix is so near a lower rank that a leg of the continuation may have crossed it."""
    return bool(np.linalg.svd(matrix, compute_uv=False)[:rank].min(initial=1.0) < 0.5 * _LEG)


def _transform(robot: Robot) -> Array | None:
    return robot.home.tool_placement.homogeneous if robot.tool_frame else None


@dataclass(frozen=True)
class Agreement:
    """Difference between the matrices of two engines.

    Attributes:
        poses: number of poses.
        redone: number of poses at which the program was in doubt.
        missing: number of poses at which only one of the two has a value.
        difference: greatest relative difference where the program was in no doubt.
    """

    poses: int
    redone: int
    missing: int
    difference: float


def compared_elasticity(model: ElasticModel, q: Matrix) -> tuple[Agreement, Agreement]:
    """Compare the compliance and the stiffness; an entry is scaled by the roots of its row's and column's diagonals.

    Entries of rigid directions are scaled by the softest one over a characteristic length.
    """
    poses = Poses(model.rigid, q)
    length = model.mechanism.characteristic_length
    agreements = []
    for quantity, unit in ((COMPLIANCE, np.repeat([length, 1.0], 3)), (STIFFNESS, np.repeat([1.0, length], 3))):
        found = evaluate(model, poses, quantity, on_failure="nan")
        careful = evaluate(model, poses, quantity, on_failure="nan", engine="pinocchio").values
        agreements.append(_agreement(found.values, careful, found.redone, _scale(careful, unit)))
    return agreements[0], agreements[1]


def model_is_rigid(model: ElasticModel, q: Matrix) -> bool:
    """Tell whether the tool is rigid in some direction, so that there is no stiffness."""
    return bool(np.isnan(stiffness(model, q[:1])).any())


def compared_sensitivities(robot: Robot, q: Matrix) -> Agreement:
    """Compare the tool's motion with every geometric error with which the loops close, and with every command."""
    poses = Poses(robot, q)
    errors = closable(GeometricErrors(robot), poses[:5])
    found, careful = (sensitivities(errors, poses, engine=engine) for engine in ("program", "pinocchio"))
    unit = np.repeat([robot.characteristic_length, 1.0], 3)[:, None]
    matrices, expected = (np.concatenate([s.errors, s.commands], axis=2) / unit for s in (found, careful))
    sizes = np.abs(expected).max(axis=1, keepdims=True)
    scale = np.broadcast_to(np.maximum(sizes, _IDLE * sizes.max(axis=2, keepdims=True)), expected.shape)
    return _agreement(matrices, expected, np.zeros(len(q), dtype=bool), scale)


def _scale(matrices: Array, unit: Vector) -> Array:
    diagonals = np.einsum("nii->ni", matrices) / unit**2
    sizes = unit * np.sqrt(np.maximum(diagonals, _RIGID * diagonals.max(axis=1, keepdims=True)))
    return sizes[:, :, None] * sizes[:, None, :]


def _agreement(matrices: Array, expected: Array, redone: Array, scale: Array) -> Agreement:
    missing = (np.isnan(matrices) != np.isnan(expected)).any(axis=(1, 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        differences = np.nan_to_num(np.abs(matrices - expected) / scale)[~redone]
    return Agreement(len(matrices), int(redone.sum()), int(missing.sum()), float(differences.max(initial=0.0)))


def closing_rows(names: Iterable[str], count: int) -> Iterable[tuple[str, Closing]]:
    """Compare closing of the named robots, from coordinates and from commands."""
    for name in names:
        robot = load(name)
        for what, coordinates in (("coordinates", robot.coordinates), ("commands", robot.command_coordinates)):
            if what == "coordinates" or coordinates != robot.coordinates:
                yield f"{name}, {what}", compared_closing(robot, coordinates, count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(DESCRIPTIONS), help=f"some of {', '.join(DESCRIPTIONS)}")
    parser.add_argument("--poses", type=int, default=POSES, help="poses of each robot")
    arguments = parser.parse_args()
    closed: dict[str, Matrix] = {}
    print("| closing | solved | only one finds | other mode | won | lost | limits differ | difference | a step later |")
    print("|---|---|---|---|---|---|---|---|---|")
    for title, row in closing_rows(arguments.names, arguments.poses):
        closed.setdefault(title.split(",")[0], row.q)
        differing = f"{row.found_otherwise} | {row.other_mode} | {row.won} | {row.lost}"
        sizes = f"{row.difference:.0e} | {row.refined:.0e}"
        print(f"| {title} | {row.solved} | {differing} | {row.limits} | {sizes} |", flush=True)
    print("\n| matrices | poses | doubtful, recomputed | NaNs differ | $C$ | $K$ | sensitivities |")
    print("|---|---|---|---|---|---|---|")
    for name, q in closed.items():
        if load(name).tool_frame is None:
            continue
        moved = f"{compared_sensitivities(load(name), q).difference:.0e}"
        if not load(name).springs:
            print(f"| {name} | {len(q)} | 0 | 0 | none | none | {moved} |", flush=True)
            continue
        model = ElasticModel(load(name))
        variants = {title: vary(model) for title, (base, vary) in VARIANTS.items() if base == name}
        for title, varied in ({name: model} | variants).items():
            C, K = compared_elasticity(varied, q)
            print(
                f"| {title} | {C.poses} | {C.redone} | {C.missing + K.missing} | {C.difference:.0e} | "
                f"{'none' if model_is_rigid(varied, q) else f'{K.difference:.0e}'} | "
                f"{moved if title == name else 'as above'} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
