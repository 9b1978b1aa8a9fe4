"""Error budget of section 8.3: all sources of error, separate and combined, and the least sensitive region.

Errors are those of :class:`~pm3dof_pin.errors.tool_errors.ToolErrors`. Repeatable errors are reduced by the part that
corrected commands undo; others, such as vibration, remain as they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.errors.command_correction import command_jacobians
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.sensitivity import Sensitivities
from pm3dof_pin.errors.source_errors import CLASSES, ErrorSources, SourceErrors
from pm3dof_pin.errors.tool_errors import ToolErrors
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array

TOGETHER = "together"
"""Name of all sources at once."""


@dataclass(frozen=True)
class BudgetLine:
    """One line of the budget: a source, or all of them, over the poses of a map."""

    name: str  #: the source, or :data:`TOGETHER`
    error_class: str  #: its class of Table 8.4
    long_name: str  #: its description
    tip_rms: float  #: tip error, root mean square over machines and poses [m]
    greatest_tip_rms: float  #: that at the worst pose [m]
    worst_tip: float  #: bound of the tip error at the worst pose [m]
    left: float  #: remaining tip error with the best commands, root mean square over machines and poses [m]
    energy: float  #: E of (8.15), mean over machines and poses [m]
    share: float  #: share of the sum of squares of all sources


@dataclass(frozen=True, eq=False)
class ErrorBudget(ToolErrors):
    """Effect of all sources of error on the tool at n poses."""

    poses: Poses  #: the poses, of the robot as described
    sources: tuple[SourceErrors, ...]  #: the sources there
    control: Array  #: the tool's motion by the commands, shape=(n, 6, number of commands)
    eta: float  #: weight of the orientation in the tip error [m/rad]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sources."""
        return tuple(source.name for source in self.sources)

    def select(self, names: Iterable[str]) -> ErrorBudget:
        """Return the budget of some sources, by name or class ("wrench", "thermal"); InvalidValueError for others."""
        selected = tuple(names)
        known = {*self.names, *CLASSES}
        for name in selected:
            if name not in known:
                raise InvalidValueError("source of error", name, f"one of {', '.join(sorted(known))}")
        chosen = tuple(s for s in self.sources if s.name in selected or s.error_class in selected)
        return ErrorBudget(self.poses, chosen, self.control, self.eta)

    @cached_property
    def shift(self) -> Array:
        """Known effect of all sources combined, shape=(n, 6) [m, rad]."""
        return frozen(np.sum([source.shift for source in self.sources], axis=0) + np.zeros((len(self.poses), 6)))

    @cached_property
    def effects(self) -> Array:
        """Effect of each independent number of all sources at one standard deviation, shape=(n, 6, k) [m, rad]."""
        return frozen(np.concatenate([np.zeros((len(self.poses), 6, 0)), *(s.effects for s in self.sources)], axis=2))

    @cached_property
    def greatest(self) -> Array:
        """The greatest value of each independent number in standard deviations, shape=(k,)."""
        return frozen(np.concatenate([np.zeros(0), *(source.greatest for source in self.sources)]))

    @property
    def left_rms(self) -> Array:
        """Remaining tip error with the best commands, root mean square over machines, shape=(n,) [m]."""
        weights = self.weights
        shift, squares = np.zeros((len(self.poses), 6)), np.zeros(len(self.poses))
        for source in self.sources:
            effects = source.effects * weights[:, None]
            if source.repeats:
                shift += source.shift * weights
                effects = self._left(effects)
            squares += np.sum(effects**2, axis=(1, 2))
        return np.asarray(np.sqrt(squares + np.sum(self._left(shift[:, :, None]) ** 2, axis=(1, 2))))

    def lines(self) -> list[BudgetLine]:
        """Return the budget source by source, and finally for all combined."""
        apart = {source.name: self.select([source.name]) for source in self.sources}
        squares = {name: float(np.mean(alone.tip_rms**2)) for name, alone in apart.items()}
        whole = sum(squares.values()) or 1.0
        lines = [apart[s.name]._line(s.name, s.error_class, s.long_name, squares[s.name] / whole) for s in self.sources]
        return [*lines, self._line(TOGETHER, "all", "all sources together", 1.0)]

    def _line(self, name: str, error_class: str, long_name: str, share: float) -> BudgetLine:
        tip = self.tip_rms
        return BudgetLine(
            name,
            error_class,
            long_name,
            float(np.sqrt(np.mean(tip**2))),
            float(tip.max()),
            float(self.worst_tip.max()),
            float(np.sqrt(np.mean(self.left_rms**2))),
            float(self.energy.mean()),
            share,
        )

    def _by_commands(self) -> Array:
        return self.control

    def _left(self, weighted: Array) -> Array:
        return np.asarray(weighted - self._basis @ (np.swapaxes(self._basis, 1, 2) @ weighted))


def error_budget(
    sources: ErrorSources,
    poses: Poses,
    *,
    eta: float = TIP_LENGTH,
    names: Sequence[str] = (),
    found: Sensitivities | None = None,
) -> ErrorBudget:
    """Compute the effect of every source of error on the tool at given poses.

    Args:
        sources: the sources with their magnitudes.
        poses: poses of the robot as described, of shape (n,).
        eta: weight of the orientation in the tip error [m/rad].
        names: sources or classes to include; all if empty.
        found: the sensitivities to the sources' geometric errors at these poses, if they are known already.

    Raises:
        InvalidValueError: there are no poses, no such source, or the loops cannot close with a geometric error.
        SingularConfigurationError: at some pose the tool can move with all drives locked, or with all springs at
            rest.
        ConvergenceError: no equilibrium was found, for large deflections.
    """
    if not len(poses):
        raise InvalidValueError("error budget", problem="has no poses", expected="at least one")
    by_class = names and all(name in CLASSES for name in names)
    effects = sources.at(poses, [known for known in CLASSES if known in names] if by_class else CLASSES, found)
    budget = ErrorBudget(poses, effects, command_jacobians(poses) if found is None else found.commands, eta)
    return budget.select(names) if names else budget


def budget_as_data(lines: Sequence[BudgetLine]) -> list[dict[str, Any]]:
    """Return the lines of a budget as plain data; keys end in their unit."""
    lengths = ("tip_rms", "greatest_tip_rms", "worst_tip", "left", "energy")
    return [{f"{key}_m" if key in lengths else key: value for key, value in vars(line).items()} for line in lines]
