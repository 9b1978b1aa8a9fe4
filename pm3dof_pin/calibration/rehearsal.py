"""Expected accuracy of a calibration method with planned poses, from simulated machines within the tolerances.

A machine is drawn: errors p within the tolerances (including those of the springs' stiffness if the plan loads the
tool), and periodic drive errors, which no parameter describes. To first order its pose errors, apart from known
deflections, are e = S p + C w, tip-weighted, and the command deviations that undo most of them are du = -(W C)^+ W e.
The method is given those of the planned poses, with the instrument's noise, and evaluated by the error that its answer
leaves over test poses (base and tool are taken to be where the instrument has them),

    excess = rms |W C (du found - du)|,

the tip error beyond that of the best possible commands. Test poses are under wrenches like those of the plan.
Second-order effects and temperatures are not simulated: a real machine is hardly better than this, and may be worse.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pm3dof_pin.calibration.fit import MIN_POSES, Method
from pm3dof_pin.calibration.learned_part import fitted_model
from pm3dof_pin.calibration.planning import PlanningProblem
from pm3dof_pin.calibration.pseudo_error import control_inverse
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Indices

MACHINES = 3
WAVES = 0.05
"""Amplitude of the drives' waves relative to the rms deviation due to the tolerances."""

_PERIODS = (0.1, 0.6)  # of the waves, relative to the range of a command


class Rehearsal:
    """Machines within the tolerances of a planning problem, to try plans and methods on.

    Raises:
        InvalidValueError: the instrument does not see full poses, or `machines` is zero.
    """

    def __init__(self, problem: PlanningProblem, generator: np.random.Generator, machines: int = MACHINES) -> None:
        if problem.instrument.measured != "pose" or problem.instrument.targets:
            raise InvalidValueError("instrument", problem.instrument.measured, "one that measures full poses")
        if machines < 1:
            raise InvalidValueError("machines", machines, "at least 1")
        self.problem = problem
        weights = problem.measured.map.weights
        self._counted = weights > 0.0
        self._sigmas = problem.instrument.sigmas * weights
        self._control, self._test_control = (
            poses.map.sensitivities.commands * weights[:, None] for poses in (problem.measured, problem.tested)
        )
        self._machines = [self._draw(generator) for _ in range(machines)]

    def excess(self, chosen: Sequence[int] | Indices, method: Method, seed: int = 0) -> float:
        """Return the excess tip error over the best commands after calibrating at candidates, rms over all [m].

        Raises:
            InvalidValueError: too few poses to learn from.
        """
        indices = np.asarray(chosen, dtype=np.intp)
        if method != "lm" and len(indices) < MIN_POSES:
            raise InvalidValueError("poses", len(indices), f"at least {MIN_POSES} to learn from")
        squares = []
        for measured, best in self._machines:
            found = self._answer(indices, method, measured[indices], seed)
            left = np.einsum("nij,nj->ni", self._test_control, found - best)
            squares.append(float(np.mean(np.sum(left**2, axis=1))))
        return float(np.sqrt(np.mean(squares)))

    def _draw(self, generator: np.random.Generator) -> tuple[Array, Array]:
        """Draw a machine: its measurements at all candidates, and the best deviations at the test poses."""
        errors = generator.standard_normal(len(self.problem.unknowns))
        sides = ((self.problem.measured, self._control), (self.problem.tested, self._test_control))
        measured, tested = (np.einsum("nij,j->ni", poses.effects, errors) for poses, _ in sides)
        size = WAVES * np.sqrt(np.mean(_undone(self._control, measured) ** 2, axis=0))
        drives = len(size)
        turns = np.pi / generator.uniform(*_PERIODS, drives)
        phases = generator.uniform(0.0, 2.0 * np.pi, drives)
        for (poses, control), errors in zip(sides, (measured, tested), strict=True):
            waves = np.sqrt(2.0) * size * np.sin(turns * poses.inputs[:, :drives] + phases)
            errors += np.einsum("nij,nj->ni", control, waves)
        measured += generator.normal(size=measured.shape) * self._sigmas
        return measured, _undone(self._test_control, tested)

    def _answer(self, indices: Indices, method: Method, measured: Array, seed: int) -> Array:
        """Return the command deviations that the method finds for the test poses."""
        problem, control = self.problem, self._control[indices]
        found = np.zeros((len(self._test_control), control.shape[2]))
        if "lm" in method:
            rows = problem.regressor[indices][:, self._counted].reshape(-1, len(problem.unknowns))
            information = np.diag(problem.sigmas**-2.0) + rows.T @ rows
            values = np.linalg.solve(
                information, rows.T @ (measured[:, self._counted] / self._sigmas[self._counted]).ravel()
            )
            measured = measured - np.einsum("nij,j->ni", problem.measured.effects[indices], values)
            found = _undone(self._test_control, np.einsum("nij,j->ni", problem.tested.effects, values))
        if method == "lm":
            return found
        variances = np.sum((control_inverse(control) * self._sigmas) ** 2, axis=2)
        model = fitted_model(method, problem.measured.inputs[indices], _undone(control, measured), variances, seed)
        return found + model.deviations(problem.tested.inputs)


def _undone(control: Array, errors: Array) -> Array:
    """Return the command deviations that undo most of the tip-weighted errors, shape=(n, number of commands)."""
    return np.asarray(-np.einsum("nij,nj->ni", control_inverse(control), errors))
