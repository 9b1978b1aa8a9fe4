"""A mechanism with springs: the tree with virtual joints, and their stiffness."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.elastic.bow import Bow
from pm3dof_pin.elastic.contact_laws import SEAT, ContactLaw
from pm3dof_pin.elastic.springs import (
    AxialSpring,
    CantileverSpring,
    ClosureSpring,
    JointLength,
    JointSpring,
    Spring,
    read_springs,
)
from pm3dof_pin.elastic.virtual_joints import insert_virtual_joints
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, JointNotFoundError, ProgramError, ShapeError
from pm3dof_pin.kinematics.robot import LoadOptions, Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array, Indices, Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.closing_programs import BoundProgram


@dataclass(frozen=True, eq=False)
class SpringBlock:
    """The stiffness of one spring over its joints: each entry is a coefficient times a power of the spring's length.

    Attributes:
        indices: entries of v of its joints, in the order of its matrix, shape=(n,).
        exponents: powers of the length, shape=(n, n); zero if the length is constant.
        bows: the shortening due to bending of each element; none if it is axially rigid or not a beam.
        law: of a contact, alike over all its joints; None if it is linear.
    """

    name: str
    indices: Indices
    coefficients: Matrix
    exponents: NDArray[np.int64]
    length: JointLength | None
    bows: tuple[Bow, ...] = ()
    law: ContactLaw | None = None

    def stiffness(self, length: float) -> Matrix:
        """Return the stiffness at a length [m], shape=(n, n) [N/m, N, N m/rad]."""
        stiffness: Matrix = self.coefficients * length**self.exponents
        return stiffness

    def stiffness_derivatives(self, length: float) -> tuple[Matrix, Matrix]:
        """Return the first and second derivatives of the stiffness by the length, shape=(n, n) each."""
        first = self.coefficients * self.exponents * length ** (self.exponents - 1)
        second = self.coefficients * self.exponents * (self.exponents - 1) * length ** (self.exponents - 2)
        return first, second


class ElasticModel:
    """A mechanism with springs. Immutable by convention.

    Joints are of three kinds. Joints of springs are elastic: the virtual joints, and joints with joint springs.
    Actuated joints without a spring are locked. All others are passive and move freely.

    Example:
        >>> import pm3dof_pin as pm
        >>> pm.ElasticModel.load("pm3dof").spring_names
        ('actuator1', 'link1', 'actuator2', 'link2', 'actuator3', 'link3', 'passive_leg')

    Args:
        mechanism: the rigid mechanism.
        springs: its springs; by default those of its description.

    Attributes:
        rigid: the mechanism as described.
        mechanism: the mechanism with virtual joints; its loops close at the same frames.
        springs: the springs.
        blocks: the stiffness of each spring over its joints.
        spring_indices: entries of v of `mechanism` with springs, block by block, shape=(s,).
        spring_slices: the slice of these of each block.
        locked_indices: entries of v of actuated joints without a spring.
        passive_indices: all other entries of v.
        rigid_indices: index in q of `mechanism` of each entry of q of `rigid`.
        rigid_velocity_indices: index in v of `mechanism` of each entry of v of `rigid`.
        programs: compiled programs used so far, see :func:`pm3dof_pin.elastic.traced.elastic_program`.

    Raises:
        FrameNotFoundError: a spring refers to an unknown joint or frame.
        JointNotFoundError: a spring or its length refers to an unknown joint.
        DescriptionError: an entry of the description's springs is invalid, the mechanism has no springs, two of them
            have the same name or joint, or the unit of a joint spring does not match its joint.
    """

    def __init__(self, mechanism: Robot, springs: Iterable[Spring] | None = None) -> None:
        require_kind("mechanism", mechanism, Robot, "pm.load")
        self.rigid = mechanism
        self.springs = _described_springs(mechanism) if springs is None else tuple(springs)
        if not self.springs:
            advice = "there are none: --drive-stiffness K (drive_stiffness=K), or `springs` in a closures file"
            raise DescriptionError(mechanism.source, "springs", advice)
        self._check_joints()
        virtual = insert_virtual_joints(mechanism, self.springs)
        self.mechanism = virtual.mechanism
        self.rigid_indices: Indices = virtual.q_indices
        self.rigid_velocity_indices: Indices = virtual.v_indices
        self.blocks = tuple(_block(self.mechanism, spring, virtual.joints.get(spring.name)) for spring in self.springs)
        self.spring_indices: Indices = frozen(np.concatenate([block.indices for block in self.blocks]))
        ends = np.cumsum([0, *(len(block.indices) for block in self.blocks)]).tolist()
        self.spring_slices = tuple(slice(first, last) for first, last in pairwise(ends))
        self.locked_indices: Indices = frozen(np.setdiff1d(self.mechanism.actuated_indices, self.spring_indices))
        springs_and_locked = np.concatenate([self.spring_indices, self.locked_indices])
        self.passive_indices: Indices = frozen(np.setdiff1d(np.arange(self.mechanism.model.nv), springs_and_locked))
        self.programs: dict[tuple[object, ...], BoundProgram | ProgramError] = {}

    @classmethod
    def load(cls, source: str | Path | pin.Model, **options: Unpack[LoadOptions]) -> ElasticModel:
        """Load a robot with its springs, as :meth:`Robot.load <pm3dof_pin.kinematics.robot.Robot.load>` does."""
        return cls(Robot.load(source, **options))

    def __repr__(self) -> str:
        return f"ElasticModel({self.rigid.name}: {len(self.springs)} springs, {self.mechanism.model.nv} velocities)"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.rigid, self.springs)  # not the programs: the copy finds them in the cache

    @property
    def spring_names(self) -> tuple[str, ...]:
        """Names of the springs, in order."""
        return tuple(spring.name for spring in self.springs)

    @cached_property
    def spring_coordinates(self) -> tuple[str, ...]:
        """Name of the joint of each entry of :attr:`spring_indices`."""
        model = self.mechanism.model
        names = {joint.idx_v: model.names[k] for k, joint in enumerate(model.joints) if k and joint.nv == 1}
        return tuple(names[int(index)] for index in self.spring_indices)

    def embed(self, q: ArrayLike) -> Vector:
        """Return q with all virtual joints at zero, shape=(..., nq of `mechanism`), from shape=(..., nq of `rigid`).

        Raises InvalidValueError for a wrong shape.
        """
        rigid = np.asarray(q, dtype=np.float64)
        if rigid.shape[-1:] != (self.rigid.model.nq,):
            expected = f"(..., {self.rigid.model.nq}), a q of the rigid mechanism"
            raise ShapeError("q", rigid.shape, expected)
        positions = np.zeros((*rigid.shape[:-1], self.mechanism.model.nq))
        positions[..., self.rigid_indices] = rigid
        return positions

    def project(self, q: ArrayLike) -> Vector:
        """Return the rigid mechanism's entries of q, the inverse of :meth:`embed`; raises as there."""
        elastic = np.asarray(q, dtype=np.float64)
        if elastic.shape[-1:] != (self.mechanism.model.nq,):
            expected = f"(..., {self.mechanism.model.nq}), a q of the mechanism with virtual joints"
            raise ShapeError("q", elastic.shape, expected)
        positions: Vector = elastic[..., self.rigid_indices]
        return positions

    def configuration(self, configuration: Configuration | ArrayLike) -> Configuration:
        """Return the configuration of the mechanism with virtual joints.

        Args:
            configuration: a configuration of the rigid mechanism or its q, to be taken with virtual joints at zero; or
                a configuration of :attr:`mechanism`, which is returned unchanged.

        Raises:
            InvalidValueError: the configuration is of another mechanism, or is not a q of the rigid one.
        """
        if not isinstance(configuration, Configuration):
            return self.mechanism.configuration(self.embed(self.rigid.checked_positions(configuration)))
        if configuration.mechanism is self.mechanism:
            return configuration
        if self.rigid.matches(configuration.mechanism):
            return self.mechanism.configuration(self.embed(configuration.q))
        problem = f"is one of {configuration.mechanism}"
        raise InvalidValueError("configuration", problem=problem, expected=f"one of {self.rigid} or its elastic model")

    def length(self, block: SpringBlock, configuration: Configuration) -> float:
        """Return the length of a spring if a joint changes it, else 1 [m]; InvalidValueError unless positive."""
        if block.length is None:
            return 1.0
        length = block.length.at_zero + configuration.joint_position(block.length.joint)
        if length <= 0.0:
            expected = f"a positive length: '{block.length.joint}' is too low"
            raise InvalidValueError(f"length of spring '{block.name}'", length, expected)
        return length

    def joint_stiffness(self, configuration: Configuration | ArrayLike) -> Matrix:
        """Return K_q over all velocities of :attr:`mechanism`, zero for passive and locked joints, shape=(nv, nv).

        Argument and errors as in :meth:`configuration`; also raises if a length changed by a joint is not positive.
        """
        where = self.configuration(configuration)
        stiffness = np.zeros((self.mechanism.model.nv, self.mechanism.model.nv))
        for block in self.blocks:
            stiffness[np.ix_(block.indices, block.indices)] = block.stiffness(self.length(block, where))
        return stiffness

    def energy_derivatives(
        self, configuration: Configuration, deflections: Vector, *, seat: float = SEAT
    ) -> tuple[Vector, Matrix]:
        """Return the first and second derivatives of the springs' energy U = d^T K_q(q) d / 2, or by their law.

        An axially elastic beam also shortens as it bends, see :class:`~pm3dof_pin.elastic.bow.Bow`. A joint that varies
        a length is loaded too: with d held, U depends on q through K_q.

        Args:
            configuration: a configuration of :attr:`mechanism`.
            deflections: d, the deflection of each velocity's joint from rest, shape=(nv,).
            seat: stiffness of contacts within their play, relative to that of the closed contact.

        Returns:
            dU/dq, shape=(nv,), and the matrix of second derivatives, shape=(nv, nv).
        """
        nv = self.mechanism.model.nv
        gradient, hessian = np.zeros(nv), np.zeros((nv, nv))
        for block in self.blocks:
            length, d = self.length(block, configuration), deflections[block.indices]
            if block.law is not None:
                force, tangent = block.law.derivatives(float(block.coefficients[0, 0]), d, seat)
                gradient[block.indices] += force
                hessian[np.ix_(block.indices, block.indices)] += tangent
                continue
            stiffness = block.stiffness(length)
            gradient[block.indices] += stiffness @ d
            hessian[np.ix_(block.indices, block.indices)] += stiffness
            joint = None if block.length is None else self.mechanism.single_joint(block.length.joint).v_index
            over = block.indices if joint is None else np.append(block.indices, joint)
            for bow in block.bows:
                slope, curvature = bow.energy_derivatives(d, bow.length or length)
                gradient[over] += slope[: len(over)]
                hessian[np.ix_(over, over)] += curvature[: len(over), : len(over)]
            if joint is not None:
                first, second = block.stiffness_derivatives(length)
                gradient[joint] += 0.5 * d @ first @ d
                hessian[joint, joint] += 0.5 * d @ second @ d
                hessian[joint, block.indices] += first @ d
                hessian[block.indices, joint] += first @ d
        return gradient, hessian

    @cached_property
    def compliance_root(self) -> tuple[Matrix, Array]:
        """A root U of the springs' compliance, K^-1 = U U^T over :attr:`spring_indices`, with all lengths 1 m.

        For other lengths, multiply row i of U by the spring's length to the power of entry i of the second array: a
        cantilever's translations scale with L^(3/2), its rotations and its elongation with L^(1/2).

        Returns:
            U, block diagonal and lower triangular, shape=(s, s); and the powers, shape=(s,).
        """
        size = len(self.spring_indices)
        root, powers = np.zeros((size, size)), np.zeros(size)
        for block, rows in zip(self.blocks, self.spring_slices, strict=True):
            root[rows, rows] = _compliance_root(block.coefficients)
            powers[rows] = -0.5 * block.exponents.diagonal()
        return frozen(root), frozen(powers)

    def scaled_compliance_root(self, configuration: Configuration) -> Matrix:
        """Return the root U of :attr:`compliance_root` at a configuration of :attr:`mechanism`, shape=(s, s)."""
        root, powers = self.compliance_root
        lengths = [np.full(len(block.indices), self.length(block, configuration)) for block in self.blocks]
        scaled: Matrix = root * (np.concatenate(lengths) ** powers)[:, None]
        return scaled

    def _check_joints(self) -> None:
        names, at_joints = set(), set()
        for spring in self.springs:
            if spring.name in names:
                raise self._error(spring.name, "duplicate name, expected unique names")
            names.add(spring.name)
            if isinstance(spring, JointSpring):
                if spring.joint in at_joints:
                    raise self._error(spring.name, f"joint '{spring.joint}' already has a spring, expected one")
                at_joints.add(spring.joint)
                unit = "N/m" if self._translates(spring.name, spring.joint) else "N m/rad"
                if spring.unit != unit:
                    raise self._error(spring.name, f"expected the unit {unit} of joint '{spring.joint}'")
            length = spring.length if isinstance(spring, CantileverSpring) else None
            if isinstance(length, JointLength) and not self._translates(spring.name, length.joint):
                raise self._error(spring.name, f"length: '{length.joint}' is revolute, expected a prismatic joint")

    def _translates(self, spring: str, name: str) -> bool:
        """Return whether a joint, which must be single-DoF, is prismatic."""
        model = self.rigid.model
        if not model.existJointName(name):
            raise JointNotFoundError(name, f"{self.rigid.source}: spring '{spring}'", list(model.names)[1:])
        if model.joints[model.getJointId(name)].nv != 1:
            raise self._error(spring, f"joint '{name}' has several degrees of freedom, expected one")
        return self.rigid.single_joint(name).translates

    def _error(self, spring: str, expected: str) -> DescriptionError:
        return DescriptionError(self.rigid.source, f"spring '{spring}'", expected)


def _described_springs(mechanism: Robot) -> tuple[Spring, ...]:
    model = mechanism.model
    single = (k for k in range(1, model.njoints) if model.joints[k].nq == 1)
    least = {model.names[k]: float(model.lowerPositionLimit[model.joints[k].idx_q]) for k in single}
    finite = {name: position for name, position in least.items() if np.isfinite(position)}
    return read_springs(mechanism.springs, mechanism.source, finite)


def _block(mechanism: Robot, spring: Spring, joints: tuple[str, ...] | None) -> SpringBlock:
    if isinstance(spring, JointSpring):
        joints = (spring.joint,)
    assert joints is not None
    length: JointLength | None = None
    bows: tuple[Bow, ...] = ()
    if isinstance(spring, (JointSpring, AxialSpring)):
        coefficients = np.array([[spring.stiffness]])
        exponents = np.zeros((1, 1), dtype=np.int64)
    elif isinstance(spring, CantileverSpring):
        coefficients, exponents = _cantilever(spring)
        if isinstance(spring.length, JointLength):
            length = spring.length
        else:
            element = coefficients * (spring.length / spring.elements) ** exponents
            coefficients = np.kron(np.eye(spring.elements), element)
            exponents = np.zeros(coefficients.shape, dtype=np.int64)
        bows = _bows(spring)
    else:
        coefficients, exponents = np.array(spring.matrix), np.zeros(spring.matrix.shape, dtype=np.int64)
    indices = mechanism.velocity_indices(joints)
    law = spring.law if isinstance(spring, (JointSpring, AxialSpring, ClosureSpring)) else None
    return SpringBlock(spring.name, indices, frozen(coefficients), frozen(exponents), length, bows, law)


def _bows(spring: CantileverSpring) -> tuple[Bow, ...]:
    if spring.axial_stiffness is None:
        return ()
    length = None if isinstance(spring.length, JointLength) else spring.length / spring.elements
    size = 6 if spring.shear_stiffness is None else 8
    return tuple(
        Bow(start + 2, frozen(start + np.array([0, 4, 1, 3])), spring.axial_stiffness, length)
        for start in range(0, size * spring.elements, size)
    )


def _cantilever(spring: CantileverSpring) -> tuple[Matrix, NDArray[np.int64]]:
    """Return coefficients and powers of L of the tip stiffness of a cantilever, z along the beam.

    The inverse of the compliance L^3/(3 E I), L^2/(2 E I), L/(E I) of bending in each plane, L/(G J) and L/(E A). Shear
    in x and y, in series with them, has joints of its own with L/(k G A): a sum of powers of L in no entry.
    """
    ei = spring.bending_stiffness
    coefficients, exponents = np.zeros((8, 8)), np.zeros((8, 8), dtype=np.int64)
    for translation, rotation, sign in ((0, 4, -1.0), (1, 3, 1.0)):
        pair = np.ix_([translation, rotation], [translation, rotation])
        coefficients[pair] = [[12.0 * ei, sign * 6.0 * ei], [sign * 6.0 * ei, 4.0 * ei]]
        exponents[pair] = [[-3, -2], [-2, -1]]
    coefficients[5, 5], exponents[5, 5] = spring.torsional_stiffness, -1
    kept = [0, 1, 3, 4, 5]
    if spring.axial_stiffness is not None:
        kept.insert(2, 2)
        coefficients[2, 2], exponents[2, 2] = spring.axial_stiffness, -1
    if spring.shear_stiffness is not None:
        kept += [6, 7]
        coefficients[[6, 7], [6, 7]], exponents[[6, 7], [6, 7]] = spring.shear_stiffness, -1
    return coefficients[np.ix_(kept, kept)], exponents[np.ix_(kept, kept)]


def _compliance_root(stiffness: Matrix) -> Matrix:
    """Return the lower triangular U with U U^T = K^-1, after scaling to a unit diagonal."""
    scale = 1.0 / np.sqrt(stiffness.diagonal())
    scaled = stiffness * np.outer(scale, scale)
    # K = R R^T with R upper triangular gives K^-1 = R^-T R^-1, and R^-T is lower triangular
    upper = np.linalg.cholesky(scaled[::-1, ::-1])[::-1, ::-1]
    root: Matrix = scale[:, None] * np.linalg.inv(upper).T
    return root
