"""The Jacobian between two descriptions of a mechanism's motion on recorded numbers, and its programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, ToolComponent
from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.closing_programs import BoundProgram, quantity_program
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.programs.closed_motions import all_motions
from pm3dof_pin.programs.derivatives import derivatives
from pm3dof_pin.programs.elimination import DROPPED, Doubt, eliminate, identity, product, samples, solve_upper, zeros
from pm3dof_pin.programs.graph import Graph, Scalar, sqrt
from pm3dof_pin.programs.joints import objects
from pm3dof_pin.programs.loops import checked_program
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Matrix, Objects

_MANY = 100  # joints, from which recording takes a second and a second way seldom saves operations


@dataclass(frozen=True)
class Rate:
    """A scalar rate: scale times that of a joint, or a component of a frame's twist, or of the tool's angles."""

    name: str
    unit: str  #: "m/s" or "rad/s"
    scale: float = 1.0
    joint: str | None = None
    frame: str | None = None
    component: ToolComponent | None = None
    is_angle: bool = False  #: the rate of rx, ry or rz, not the angular velocity


def rate_of_coordinate(coordinate: Coordinate) -> Rate:
    """Return the rate of a coordinate or command."""
    unit = f"{coordinate.unit}/s"
    if coordinate.joint is not None:
        return Rate(coordinate.name, unit, coordinate.scale, joint=coordinate.joint)
    return Rate(coordinate.name, unit, coordinate.scale, component=coordinate.tool, is_angle=coordinate.unit == "rad")


def bound_jacobian(
    robot: PlacedMechanism, of: Sequence[Rate], by: Sequence[Rate], *, with_derivatives: bool
) -> BoundProgram:
    """Return the program of a Jacobian at q, kept for the robot; outputs and errors as :func:`jacobian_program`."""

    def trace() -> Program:
        poses = samples_near_home(robot)
        verify(robot, poses)
        return jacobian_program(robot, of, by, poses, with_derivatives=with_derivatives)

    own = ("jacobian", of, by, with_derivatives)
    return quantity_program(robot, own, trace, frames=_frames(robot, of, by))


def _frames(robot: PlacedMechanism, *rates: Sequence[Rate]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(robot.frame_name(rate.frame) for group in rates for rate in group if rate.joint is None))


def jacobian_program(
    robot: PlacedMechanism,
    of: Sequence[Rate],
    by: Sequence[Rate],
    poses: Matrix,
    *,
    with_derivatives: bool = False,
    dense: bool = False,
) -> Program:
    """Record a Jacobian; outputs `values`, flat, and `sound`, 1 if the loops are closed and nothing is in doubt.

    `poses` are closed configurations near home, shape=(s, nq); `dense` as for
    :class:`~pm3dof_pin.programs.tree.Tree`.

    Raises:
        ProgramError: the motions of `by` do not determine those of `of` at the sample poses.
    """
    doubt = Doubt()
    tree = Tree(Graph(), robot, poses, _frames(robot, of, by), dense=dense, in_working_axes=True)
    velocities, _ = recorded_motions(tree, by, of, doubt)
    values = product(_rows(tree, of), velocities)
    flat = values.ravel()
    if with_derivatives:
        rates = np.stack([tree.rate(velocities[:, column]) for column in range(len(by))], axis=-1)
        along = derivatives(values, dict(zip(tree.q, rates, strict=True)))
        flat = np.concatenate([flat, ((along + along.swapaxes(1, 2)) * 0.5).ravel()])
    return checked_program("jacobian", tree, flat, doubt)


def recorded_motions(tree: Tree, by: Sequence[Rate], of: Sequence[Rate], doubt: Doubt) -> tuple[Objects, Objects]:
    """Record the joint velocities at unit rate of each of `by`, shape=(nv, m) [SI units], and the idle motions.

    Idle motions, shape=(nv, i), are those that neither sees, such as a rod's spin about its own axis. Redundant rates
    that disagree are met by least squares. Of equally sparse joints the last follow first, or the first if the rates of
    `of` then take fewer operations.

    Raises:
        ProgramError: rates of `of` can change while those of `by` are at rest, at the sample poses.
    """
    joints = range(tree.mechanism.model.nv)
    ways = [(Doubt(), order) for order in (joints, joints[::-1])[: 2 if len(joints) < _MANY else 1]]
    found = [(*_motions_by(tree, by, of, order, own), own) for own, order in ways]
    wanted = _rows(tree, of)
    motions, idle, own = min(found, key=lambda way: tree.graph.operations(*product(wanted, way[0]).ravel()))
    doubt.note_pivot(own.pivot)
    doubt.drop([own.dropped])
    return motions, idle


def _motions_by(
    tree: Tree, by: Sequence[Rate], of: Sequence[Rate], order: Sequence[int], doubt: Doubt
) -> tuple[Objects, Objects]:
    """Record what :func:`recorded_motions` does, with joints in an order, see :func:`all_motions`."""
    robot = tree.mechanism
    unit, slides = robot.length_unit, tree.slides
    basis = all_motions(tree, order, unit, doubt)
    basis[slides] = basis[slides] * unit
    factors = [
        np.array([[1.0 / ((unit if rate.unit == "m/s" else 1.0) * abs(rate.scale))] for rate in rates])
        for rates in (of, by)
    ]
    wanted, given = (_rows(tree, rates) * scale for rates, scale in zip((of, by), factors, strict=True))
    solved = eliminate(product(given, basis), range(basis.shape[1]), doubt)
    pivots, dropped = list(solved.columns), list(solved.dropped)
    if len(pivots) < min(len(by), basis.shape[1] - len(dropped)):
        raise ProgramError(f"{robot.name}: the rates that are given depend on each other")
    triangle = solved.pivot_rows[:, pivots]
    doubt.note_basis(triangle)
    at_rest = zeros(basis.shape[1], len(dropped))  # motions that the given rates do not see
    for column, index in enumerate(dropped):
        at_rest[index, column] = 1.0
    at_rest[pivots] = -solve_upper(triangle, solved.pivot_rows[:, dropped])
    for entry in product(product(wanted, basis), at_rest).ravel():
        if np.nanmax(np.abs(samples(entry))) > DROPPED:
            raise ProgramError(
                f"{robot.name}: wanted rates can move while the given ones are at rest: expected as "
                "many given rates as determine them; declare further coordinates, such as joints of the arm or the legs"
            )
        doubt.drop([entry])
    rates: Objects = product(basis[:, pivots], solve_upper(triangle, solved.carry(identity(len(by)))[0]))
    return rates * factors[1].T, product(basis, at_rest)


def _rows(tree: Tree, rates: Sequence[Rate]) -> Objects:
    """Record the derivatives of rates by v, shape=(k, nv)."""
    robot = tree.mechanism
    rows = zeros(len(rates), robot.model.nv)
    for k, rate in enumerate(rates):
        if rate.joint is not None:
            rows[k, robot.single_joint(rate.joint).v_index] = rate.scale
            continue
        name = robot.frame_name(rate.frame)
        twist = tree.jacobian(name)
        index = TOOL_COMPONENTS.index(rate.component)
        row = _angle_row(tree, name, index - 3) @ twist[3:] if rate.is_angle else twist[index]
        rows[k] = row * rate.scale
    return rows


def _angle_row(tree: Tree, frame: str, index: int) -> Objects:
    """Record the rate of rx, ry or rz by the angular velocity, see :func:`angle_rates`, shape=(3,)."""
    r = tree.in_world(tree.frame(frame)).rotation
    cy: Scalar = sqrt(r[0, 0] * r[0, 0] + r[0, 1] * r[0, 1])
    cx, sx, sy = r[2, 2] / cy, -r[1, 2] / cy, r[0, 2]
    match index:
        case 0:
            return objects([1.0, sx * sy / cy, -cx * sy / cy])
        case 1:
            return objects([0.0, cx, sx])
    return objects([0.0, -sx / cy, cx / cy])
