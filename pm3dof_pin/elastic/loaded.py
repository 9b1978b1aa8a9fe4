"""Elastic mechanisms under load: equilibrium and tangent stiffness.

The springs are at rest in a given configuration. The equilibrium under loads satisfies

    dU/dq = forces(q) + G^T lambda   and   closure error = 0,

with the springs' energy U and the closure forces lambda. The tangent stiffness is the response to a small additional
wrench dw: in

    [ H  -G^T ] [dq     ]   [J^T dw]
    [ G    0  ] [dlambda] = [0     ],    H = d^2U/dq^2 - d(forces + G^T lambda)/dq,

the compliance is J dq/dw. On the motions Z of :mod:`pm3dof_pin.elastic.motions`, with Z^T K_q Z = 1, Z^T H Z is 1 plus
the stiffness that the loads add or remove; the mechanism buckles where its least eigenvalue becomes zero. Motions held
by loads but not by springs, such as a pendulum under gravity, are included.

Deflections within one beam or cantilever spring must be small: its stiffness is that of its tip. An axially elastic
cantilever shortens as it bends (:mod:`pm3dof_pin.elastic.bow`), so that a single one buckles within 1 % of Euler's
load. An axially rigid one, and a beam given by a matrix, keep their length: cut these into several elements if an axial
force approaches E I / L^2; the error of a column's buckling load then falls with the square of their number.

H is symmetric if the loads have a potential. A moment of fixed direction in the world has none, unless the body turns
about one axis only: the tangent stiffness is then asymmetric (J. Kovecses and J. Angeles, Multibody System Dynamics 18,
2007).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, require_kind
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.load_path import LoadPath
from pm3dof_pin.elastic.loaded_state import LoadedState
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.report import direction_names, range_and_complement
from pm3dof_pin.exceptions import DeflectionRangeError, FreeDirectionError, RigidDirectionError
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix, Vector

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class LoadedEquilibrium:
    """The equilibrium of an elastic mechanism under loads."""

    factor: float  #: the load factor
    steps: int  #: number of Newton steps
    state: LoadedState  #: motions, forces and tangent stiffness there

    @property
    def configuration(self) -> Configuration:
        """The configuration under load, of the mechanism with virtual joints."""
        return self.state.configuration

    @property
    def residual(self) -> float:
        """Greatest unbalanced generalised force [N or N m]."""
        return float(np.abs(self.state.unbalanced).max(initial=0.0))

    @property
    def least_eigenvalue(self) -> float:
        """Least eigenvalue of Z^T H Z (of its symmetric part, if the loads have no potential).

        1 without loads, or less if some motions are held by loads alone; zero at buckling, negative beyond.
        """
        return self.state.least_eigenvalue

    @property
    def stable(self) -> bool:
        """Whether the equilibrium is stable."""
        return self.state.least_eigenvalue > 0.0

    @property
    def closure_forces(self) -> Vector:
        """Force (6d: wrench) on frame b of each closure, opposite to that on frame a, in the axes of frame a.

        Closure by closure, shape=(m,) [N, N m]. If constraints are redundant, one of many solutions.
        """
        return frozen(self.state.closure_forces.copy())

    @property
    def spring_deflections(self) -> Vector:
        """Deflection of each joint with a spring from rest, shape=(s,) [m, rad].

        In the order of :attr:`ElasticModel.spring_coordinates`.
        """
        return frozen(self.state.deflections[self.state.model.spring_indices])

    def displacement(self, frame: str | None = None) -> Vector:
        """Return the displacement of a frame, by default the tool, relative to the configuration with springs at rest.

        Translation of its origin and rotation vector, world axes, shape=(6,) [m, rad].

        Raises:
            FrameNotFoundError: the model has no such frame.
            DescriptionError: no frame is given, and the mechanism has no tool frame.
        """
        name = self._mechanism.frame_name(frame)
        before, after = (placed.frame_placement(name) for placed in (self.state.rest, self.configuration))
        turned = pin.log3(after.rotation @ before.rotation.T)
        return frozen(np.concatenate([after.translation - before.translation, turned]))

    def tangent_compliance(self, frame: str | None = None) -> Matrix:
        """Return the tangent compliance of a frame: its twist for a small additional wrench at its origin, world axes.

        Shape=(6, 6) [m/N, 1/N, rad/(N m)], symmetric if the loads have a potential.

        Raises:
            FreeDirectionError: the frame moves freely in some direction.
            PM3DofError: there is no such frame, as for :meth:`displacement`.
        """
        name, unit = self._mechanism.frame_name(frame), self._mechanism.twist_scale[:, None]
        jacobian = self.configuration.frame_jacobian(name)
        free = range_and_complement(jacobian @ self.state.idle_motions / unit, self._threshold(jacobian))[0]
        if free.size:
            raise FreeDirectionError(f"frame '{name}' moves freely under load: {direction_names(unit * free)}")
        twists = jacobian @ self.state.bearing_motions
        compliance: Matrix = twists @ np.linalg.solve(self.state.tangent, twists.T)
        return frozen(compliance)

    def tangent_stiffness(self, frame: str | None = None) -> Matrix:
        """Return the inverse of :meth:`tangent_compliance`, shape=(6, 6) [N/m, N, N m/rad].

        Raises:
            RigidDirectionError: the frame is rigid in some direction.
            PM3DofError: as :meth:`tangent_compliance`.
        """
        name, unit = self._mechanism.frame_name(frame), self._mechanism.twist_scale[:, None]
        jacobian = self.configuration.frame_jacobian(name)
        motions = self.state.motions
        moved = jacobian @ np.hstack([motions.kinematic, motions.unstrained])
        rigid = range_and_complement(moved / unit, self._threshold(jacobian))[1]
        if rigid.size:
            raise RigidDirectionError(f"frame '{name}' is rigid: {direction_names(unit * rigid)}")
        compliance = self.tangent_compliance(name)
        scale: Vector = 1.0 / np.linalg.norm(jacobian @ self.state.bearing_motions, axis=1)
        scales = np.outer(scale, scale)
        stiffness: Matrix = scales * np.linalg.inv(scales * compliance)
        return frozen(stiffness)

    @property
    def _mechanism(self) -> Robot:
        return self.state.model.mechanism

    def _threshold(self, jacobian: Matrix) -> float:
        scaled = jacobian * self._mechanism.velocity_scale / self._mechanism.twist_scale[:, None]
        return RANK_TOLERANCE * float(np.linalg.norm(scaled, 2))


def loaded_equilibrium(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    loads: Loads,
    *,
    guess: Configuration | None = None,
) -> LoadedEquilibrium:
    """Find the equilibrium of an elastic mechanism under loads.

    The loads grow from zero to full, and the equilibrium is followed with the exact tangent stiffness, in one step if
    they are small. If it becomes unstable at a bifurcation, a stable branch is followed. The loops are closed after
    each step. Actuated joints hold their positions, through their springs if they have any.

    If the path ends before full load, at a limit point, the mechanism jumps: the result is the stable equilibrium to
    which it settles when released under full load with damping. This is logged as a warning, as are bifurcations passed
    on the way. Only equilibria held by loads alone, and those found by Newton's method from a guess, may be unstable;
    this too is logged as a warning.

    Example:
        >>> import pm3dof_pin as pm
        >>> model = pm.ElasticModel.load("pm3dof")
        >>> loads = pm.Loads(wrenches={"O_e": [300.0, 0.0, 0.0, 0.0, 0.0, 0.0]})
        >>> equilibrium = pm.loaded_equilibrium(model, model.rigid.home, loads)
        >>> sideways = equilibrium.configuration.tool_placement.translation[0]
        >>> print(f"{1e6 * sideways:.1f} micrometres")
        165.9 micrometres

    Args:
        model: the elastic mechanism.
        configuration: configuration with springs at rest: an assembled one of the rigid mechanism, or its q.
        loads: the loads.
        guess: configuration of the mechanism with virtual joints from which to start Newton's method, instead of
            following the equilibrium from rest.

    Raises:
        ConvergenceError: no stable equilibrium was found: the loads may exceed what the mechanism can bear.
        DeflectionRangeError: a spring that represents a body is deflected further than a body can be.
        FrameNotFoundError: a load acts on a frame that the model does not have.
        InvalidValueError: a load is not finite or of the wrong shape, the loops are not closed, or a length changed by
            a joint is not positive.
        DescriptionError: the model has joints for which Pinocchio's derivatives are wrong.
    """
    require_kind("model", model, ElasticModel, "pm.ElasticModel.load")
    path = LoadPath(model, configuration, loads, None)
    if guess is None:
        state, steps = path.settle()
    else:
        state, steps = path.equilibrium(1.0, model.configuration(guess))
    if state.out_of_range:
        raise DeflectionRangeError(state.out_of_range, 0.0)
    if state.least_eigenvalue <= 0.0:
        _log.warning("the equilibrium under load is not stable: least eigenvalue %.3g", state.least_eigenvalue)
    return LoadedEquilibrium(1.0, steps, state)


def load_deflection(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    loads: Loads,
    factors: ArrayLike,
    *,
    permanent: Loads | None = None,
) -> tuple[LoadedEquilibrium, ...]:
    """Follow the equilibrium under growing loads: the load-deflection curve at given load factors, shape=(n,).

    The path between factors is followed by arc length, so that it cannot jump to another nearby equilibrium. It ends at
    a limit point. At a bifurcation it continues along a stable branch, and a
    warning with the factor and the branch is logged. Other arguments and errors as in :func:`loaded_equilibrium`;
    `permanent` loads always act in full.

    Raises:
        ConvergenceError: the path turns back before a factor is reached, or a bifurcation has no stable branch; the
            message says where.
        DeflectionRangeError: a spring that represents a body is deflected further than a body can be.
        InvalidValueError: the factors are not finite or not a list.
    """
    targets = finite_array("factors", factors, (np.size(factors),))
    path = LoadPath(model, configuration, loads, permanent)
    point = path.begin(path.unloaded(), float(np.abs(targets).max(initial=0.0)) or 1.0)
    curve = []
    for target in targets:
        point = path.follow(point, float(target))
        curve.append(LoadedEquilibrium(point.factor, point.steps, point.state))
    return tuple(curve)
