"""What `pm3dof export function` can write: every traced program of a robot, by the name of its quantity.

A further quantity is a function of a robot that returns its program, and a line in :data:`QUANTITIES`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.dynamics.motion_dynamics import motion_dynamics, motion_dynamics_program
from pm3dof_pin.dynamics.motion_forces import drive_motions
from pm3dof_pin.dynamics.traced import drives_program, vibrations_program
from pm3dof_pin.elastic import quantities as elastic
from pm3dof_pin.elastic.batch import elastic_model, evaluate
from pm3dof_pin.elastic.traced import elastic_program
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.error_sums import KinematicSum, kinematic_sum, kinematic_sum_program
from pm3dof_pin.errors.sensitivity import closable, sensitivities
from pm3dof_pin.errors.sensitivity_program import at_zero_errors
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError, ProgramError
from pm3dof_pin.kinematics.closing_programs import BoundProgram, program_source
from pm3dof_pin.kinematics.degrees_of_freedom import scaled_closures
from pm3dof_pin.kinematics.jacobian_programs import bound_jacobian
from pm3dof_pin.kinematics.jacobians import MotionName, jacobian, motion_rates
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity_measures import scaled_jacobians
from pm3dof_pin.programs.program import Program
from pm3dof_pin.typing import Array, Vector

KINEMATICS = ("commands", "coordinates", "transform", "jacobian")
"""Quantities that every controller has, see :class:`~pm3dof_pin.export.controller.Controller`."""

_KEPT = "_exported_errors"
_AGREE = 1e-9  # relative, of a program and what Pinocchio computes

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Described:
    """A quantity of one robot as a function of q."""

    text: str  #: what the function returns, without its shape
    axes: str  #: names of the last axes, as in docstrings
    shape: tuple[int, ...]  #: of its value
    program: Program  #: its input is q; its outputs are `values`, and `sound`, 1 if they hold
    parameters: Vector  #: values of its parameters
    reference: Callable[[Poses], Array]  #: computes it by Pinocchio, shape=(n, *shape)
    least_scale: float = 0.0  #: size that differences are at least relative to


def describe_quantity(robot: Robot, name: str) -> Described:
    """Return a quantity of a robot by its name, see :func:`all_quantities`.

    Raises:
        InvalidValueError: the name is unknown, or the robot lacks what it needs.
        ProgramError: there is no program for the robot.
        PM3DofError: as the function that computes it for a batch of poses.
    """
    if name in QUANTITIES:
        return QUANTITIES[name](robot)
    of, _, by = name.removesuffix("_derivatives").partition("_by_")
    if not by:
        known = ", ".join((*KINEMATICS, *QUANTITIES))
        raise InvalidValueError("of", name, f"all, A_by_B, A_by_B_derivatives, or one of {known}")
    return _jacobian(robot, of, by, with_derivatives=name.endswith("_derivatives"))


def all_quantities(robot: Robot) -> Iterator[tuple[str, Described]]:
    """Yield all quantities of a robot that exist, by name; of Jacobians, those between whole descriptions."""
    tool = ("tool",) if robot.tool_frame is not None else ()
    pairs = product(("commands", "coordinates", "joints", *tool), ("coordinates", "commands"))
    jacobians = [f"{of}_by_{by}" for of, by in pairs if of != by]
    for name in (*jacobians, "commands_by_coordinates_derivatives", *QUANTITIES):
        try:
            found = describe_quantity(robot, name)
        except PM3DofError as error:
            _logger.info("%s has no %s: %s", robot.name, name, error)
            continue
        values = found.program.evaluate(program_source(robot).samples, found.parameters)
        exists = ~np.isnan(values).any(axis=1)
        if len(found.program.results) > np.prod(found.shape):
            exists &= values[:, -1] > 0.5
        if exists.any():
            yield name, found
        else:
            _logger.info("%s has no %s: it is not a number near home", robot.name, name)


def _bound(
    found: BoundProgram,
    text: str,
    axes: str,
    shape: tuple[int, ...],
    reference: Callable[[Poses], Array],
    *,
    chosen: Sequence[int] | None = None,
    least_scale: float = 0.0,
) -> Described:
    """Describe a program whose last output is 1 if it holds; `chosen` are the entries of the shape, flat."""
    program, size = found.compiled.program, int(np.prod(shape))
    outputs = {"values": shape, "sound": ()}
    places = [*(range(size) if chosen is None else chosen), len(program.results) - 1]
    return Described(text, axes, shape, program.of_results(outputs, places), found.parameters, reference, least_scale)


def _jacobian(robot: Robot, of: str, by: str, *, with_derivatives: bool) -> Described:
    ends: list[MotionName] = [robot.actuated_joints if name == "drives" else name for name in (of, by)]
    rows, columns = motion_rates(robot, "of", ends[0]), motion_rates(robot, "by", ends[1])
    found = bound_jacobian(robot, rows, columns, with_derivatives=with_derivatives)
    program, parameters = found.compiled.program, found.parameters
    k, m = len(rows), len(columns)

    def reference(poses: Poses) -> Array:
        found = jacobian(robot, poses, of=ends[0], by=ends[1], with_derivatives=with_derivatives, engine="pinocchio")
        values = found.derivatives if with_derivatives else found.values
        assert values is not None
        return values

    first, size = (k * m, k * m * m) if with_derivatives else (0, k * m)
    shape = (k, m, m) if with_derivatives else (k, m)
    names = (
        ", ".join(f"{rate.name} [{rate.unit}]" for rate in rows),
        ", ".join(f"{rate.name} [{rate.unit}]" for rate in columns),
    )
    text = f"the rates {names[0]} by {names[1]}"
    if with_derivatives:
        text = f"the second derivatives that give accelerations of {names[0]} at constant rates {names[1]}"
    outputs = {"values": shape, "sound": ()}
    chosen = program.of_results(outputs, [*range(first, first + size), len(program.results) - 1])
    axes = f"{of}, {by}, {by}" if with_derivatives else f"{of}, {by}"
    # second derivatives may be zero: they are rounded by as much as the first ones are
    least = np.abs(program.evaluate([robot.home.q], parameters)[0, : k * m]).max() if with_derivatives else 0.0
    return Described(text, axes, shape, chosen, parameters, reference, float(np.nan_to_num(least)))


def _elastic(make: Callable[[Robot], elastic.ElasticQuantity], text: str, axes: str) -> Callable[[Robot], Described]:
    def described(robot: Robot) -> Described:
        if not robot.springs:
            raise InvalidValueError(robot.name, problem="has no springs", expected="some for its compliance")
        found, model = make(robot), elastic_model(robot)
        program = elastic_program(model, robot.frame_name(), found.name, found.traced)
        return _bound(
            program,
            text,
            axes,
            found.shape,
            lambda poses: evaluate(robot, poses, found, engine="pinocchio").values,
        )

    return described


def _holding_forces(robot: Robot) -> Described:
    return _bound(
        drives_program("holding_forces", robot, robot.model),
        "the forces of the drives, along their joints, that hold the weight [N, N m]",
        "drives",
        (len(robot.actuated_joints),),
        lambda poses: actuator_forces(robot, poses, engine="pinocchio"),
        least_scale=_weight(robot),
    )


def _mass_matrix(robot: Robot) -> Described:
    return _bound(
        drives_program("mass_matrix", robot, robot.model),
        "the inertia that the drives feel [kg, kg m, kg m^2]",
        "drives, drives",
        (len(robot.actuated_joints),) * 2,
        lambda poses: drive_mass_matrices(robot, poses, engine="pinocchio"),
    )


def _drive_motions(robot: Robot) -> Described:
    robot.frame_name()
    nv, drives = robot.model.nv, len(robot.actuated_joints)

    def reference(poses: Poses) -> Array:
        found = drive_motions(robot, poses)
        return np.concatenate([found.joints, found.tool], axis=1)

    return _bound(
        drives_program("drive_motions", robot, robot.model),
        "the least velocities of all joints, then the twist of the tool, at unit rate of each drive",
        "velocities + 6, drives",
        (nv + 6, drives),
        reference,
    )


def _inertia(robot: Robot) -> Described:
    m = len(robot.coordinates)
    return _bound(
        motion_dynamics_program(robot, "coordinates"),
        "the inertia that the coordinates feel [kg, kg m, kg m^2]",
        "coordinates, coordinates",
        (m, m),
        lambda poses: motion_dynamics(robot, poses, by="coordinates", engine="pinocchio").inertia,
    )


def _weight_felt(robot: Robot) -> Described:
    m = len(robot.coordinates)
    return _bound(
        motion_dynamics_program(robot, "coordinates"),
        "the forces along the coordinates that hold the weight [N, N m]",
        "coordinates",
        (m,),
        lambda poses: motion_dynamics(robot, poses, by="coordinates", engine="pinocchio").weight,
        chosen=range(m * m, m * m + m),
        least_scale=_weight(robot),
    )


def _weight(robot: Robot) -> float:
    """Return the size of forces and moments of the weight [N, N m]."""
    mass = sum(body.mass for body in robot.model.inertias)
    return float(np.linalg.norm(robot.model.gravity.linear) * mass * min(1.0, robot.length_unit))


def _vibrations(robot: Robot) -> Described:
    model = elastic_model(robot)
    found = vibrations_program(model, model.mechanism.model)
    count = len(found.compiled.program.results) - 1
    size = math.isqrt(2 * count)
    numbers = np.zeros((size, size), dtype=int)
    numbers[np.tril_indices(size)] = range(count)
    numbers = np.maximum(numbers, numbers.T)

    def reference(poses: Poses) -> Array:
        """Return the program's matrices, of which Pinocchio gives the eigenvalues."""
        values = found.compiled.program.evaluate(poses.q, found.parameters)[:, numbers]
        for q, matrix in zip(poses.q, values, strict=True):
            frequencies = natural_modes(model, q).frequencies
            wanted = np.zeros(size)
            wanted[: len(frequencies)] = 1.0 / (2.0 * np.pi * frequencies) ** 2
            squares = np.linalg.eigvalsh(matrix)[::-1]
            if np.abs(squares - wanted).max() > _AGREE * wanted.max():
                raise ProgramError(f"{robot.name}: natural frequencies differ from those of Pinocchio")
        return values

    return _bound(
        found,
        "the symmetric matrix whose eigenvalues are 1 / (2 pi f)^2 of the natural frequencies f [s^2]",
        "modes, modes",
        (size, size),
        reference,
        chosen=numbers.ravel().tolist(),
    )


def _constraint_jacobian(robot: Robot) -> Described:
    found = scaled_jacobians(robot)
    program = found.compiled.program
    shape = program.outputs["closures"]

    def reference(poses: Poses) -> Array:
        """Return the program's matrices, of which Pinocchio gives the singular values."""
        values = program.split(program.evaluate(poses.q, found.parameters))["closures"]
        for q, matrix in zip(poses.q, values, strict=True):
            own, wanted = (
                np.linalg.svd(each, compute_uv=False) for each in (matrix, scaled_closures(robot.configuration(q)))
            )
            if np.abs(own - wanted).max() > _AGREE * wanted.max():
                raise ProgramError(f"{robot.name}: the closures' Jacobian differs from that of Pinocchio")
        return values

    if not shape[0]:
        raise InvalidValueError(robot.name, problem="has no loops", expected="some for the Jacobian of its closures")
    places = range(program.slices["closures"].start, program.slices["closures"].stop)
    text = "the Jacobian of the loop closures, lengths over the characteristic one, singular where the loops are"
    only = program.of_results({"values": shape}, places)
    return Described(text, "constraints, velocities", shape, only, found.parameters, reference)


def _error_sources(robot: Robot) -> ErrorSources:
    """Return the errors of the robot's error file, or else all, that leave its loops closable; kept for the robot."""
    robot.frame_name()
    if _KEPT not in vars(robot):
        file = None if robot.files is None else robot.files.errors
        given = GeometricErrors.from_file(robot, file) if file is not None and file.is_file() else None
        declared = GeometricErrors(robot) if given is None else given
        vars(robot)[_KEPT] = ErrorSources(closable(declared, robot.at([robot.home.q])))
    found: ErrorSources = vars(robot)[_KEPT]
    return found


def _geometric_error(name: KinematicSum, text: str) -> Callable[[Robot], Described]:
    def described(robot: Robot) -> Described:
        sources = _error_sources(robot)
        found = kinematic_sum_program(sources, name)
        return _bound(
            found,
            text,
            "",
            (),
            lambda poses: kinematic_sum(sources, poses, name, engine="pinocchio").values,
            least_scale=float(sources.errors.tolerances.max(initial=0.0)),
        )

    return described


def _error_sensitivities(robot: Robot) -> Described:
    errors = _error_sources(robot).errors
    program, parameters = at_zero_errors(errors)
    count = len(errors)
    places = [*range(6 * count), program.slices["sound"].start]
    return Described(
        f"the tool's displacement [translation; rotation] for one unit of each geometric error: "
        f"{', '.join(errors.names)} [1, m/rad; rad/m, 1]",
        "6, errors",
        (6, count),
        program.of_results({"values": (6, count), "sound": ()}, places),
        parameters,
        lambda poses: sensitivities(errors, poses, engine="pinocchio").errors,
    )


QUANTITIES: dict[str, Callable[[Robot], Described]] = {
    "compliance": _elastic(
        lambda robot: elastic.COMPLIANCE,
        "the compliance of the tool, twist = C wrench [m/N, 1/N; 1/N, rad/(N m)]",
        "6, 6",
    ),
    "stiffness": _elastic(
        lambda robot: elastic.STIFFNESS,
        "the stiffness of the tool, wrench = K twist [N/m, N; N, N m/rad]",
        "6, 6",
    ),
    "axis_compliance": _elastic(
        lambda robot: elastic.AXIS_COMPLIANCE,
        "the deflections along each axis under a unit force or moment along it [m/N, rad/(N m)]",
        "6",
    ),
    "principal_stiffness": _elastic(
        lambda robot: elastic.PRINCIPAL_STIFFNESS,
        "the principal stiffnesses of translations, then rotations, ascending [N/m, N m/rad]",
        "2, 3",
    ),
    "conditioning": _elastic(
        lambda robot: elastic.CONDITIONING,
        "the eigenvalues of K at its characteristic length, ascending [N/m], then this length [m]",
        "7",
    ),
    "coordinate_stiffness": _elastic(
        lambda robot: elastic.free_stiffness(elastic_model(robot)),
        "the stiffness of the coordinates, drives at rest [N/m, N, N m/rad]",
        "coordinates, coordinates",
    ),
    "spring_shares": _elastic(
        lambda robot: elastic.spring_shares(elastic_model(robot)),
        "the share of each spring in the deflection under a unit wrench along each axis",
        "6, springs",
    ),
    "compliance_by_spring": _elastic(
        lambda robot: elastic.compliance_by_spring(elastic_model(robot)),
        "the contribution of each spring to the compliance of the tool [m/N, 1/N; 1/N, rad/(N m)]",
        "springs, 6, 6",
    ),
    "holding_forces": _holding_forces,
    "mass_matrix": _mass_matrix,
    "drive_motions": _drive_motions,
    "coordinate_inertia": _inertia,
    "coordinate_weight": _weight_felt,
    "vibrations": _vibrations,
    "error_sensitivities": _error_sensitivities,
    "geometric_error": _geometric_error("tip_rms", "the tip error due to geometry, root mean square over machines [m]"),
    "geometric_error_bound": _geometric_error("worst_tip", "a bound of the tip error due to geometry [m]"),
    "geometric_error_left": _geometric_error(
        "left_rms", "the tip error due to geometry that no command can undo, root mean square over machines [m]"
    ),
    "constraint_jacobian": _constraint_jacobian,
}
"""Makers of quantities that are functions of q alone, by name."""
