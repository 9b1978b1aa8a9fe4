"""Is a calibration still true? The last one as prior, and a few new rows.

Three hypotheses, each with what the one before it has, explain the residuals r of the new rows about the calibrated
machine, in units of their noise:

    unchanged      r = N(0, V),  V = 1 + A P A^T + noise of what else the rows depend on + scatter,
    re-zero        V + z^2 Z Z^T: the drives' zeros moved,
    recalibrate    V + z^2 Z Z^T + s^2 A T^2 A^T: parts moved, too, by s tolerances,

with P the covariance of the calibration, A and Z the effects of parameters and zeros, T the tolerances. The sizes z
and s are unknown: the likelihoods are averaged over them, uniform in the logarithm (H. Jeffreys, Theory of Probability,
1939). A hypothesis that more parameters could only fit better thus needs evidence. For moved parts it must be twenty
times that for the others: a likelihood ratio has the mean 1 where its denominator is true, so that at most one in
twenty machines of which zeros alone moved, by such sizes, is sent to a calibration (Markov's inequality). Effects are
those at the zeros found: zeros that are millimetres off move the tool by more than the derivatives at the old ones say.
Mixed over hypotheses and sizes, the changes tell how far the tool is off if nothing is done, or only zeros are set.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import scipy

from pm3dof_pin.calibration.compensation import Compensation, Conditions
from pm3dof_pin.calibration.folder import HISTORY, read_compensation
from pm3dof_pin.calibration.linearisation import tool_motions_by_drives
from pm3dof_pin.errors.command_correction import weighted_control
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, PM3DofError
from pm3dof_pin.files import read_text, write_text_atomically
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.measurements import Measurements, with_joints
from pm3dof_pin.measuring.nuisances import Nuisances, datum_motions
from pm3dof_pin.measuring.wrenches import is_wrench
from pm3dof_pin.typing import Array

Verdict = Literal["unchanged", "re-zero", "recalibrate"]

_ZEROS = {"m": np.geomspace(3e-6, 3e-2, 17), "rad": np.geomspace(1e-5, 1e-1, 17)}
"""Sizes of changes of zeros, as many for each unit of a drive [m, rad]."""
_CHANGES = np.geomspace(0.3, 30.0, 9)  # sizes of other changes, in tolerances
_BEFOREHAND: dict[Verdict, float] = {"unchanged": 1.0, "re-zero": 1.0, "recalibrate": 0.05}  # relative probabilities
_NEGLIGIBLE = 1e-6  # probability of a change that does not count
_ROUNDS, _SETTLED = 8, 0.01  # of effects at the zeros found; in standard deviations of a row
_UNLIKELY = 5e-3  # a verdict that the rows contradict with this probability does not stand
_NOTICED = scipy.special.ndtri(0.95) + scipy.special.ndtri(0.975)  # standard errors that are noticed with 95 %
_POSES = 200  # over which the tool is judged
_LARGEST_SIGMA = 1e3


@dataclass(frozen=True, eq=False)
class Recheck:
    """Whether a calibration still holds, and what acting on either answer risks."""

    verdict: Verdict  #: the most probable; "recalibrate" too if the rows contradict the most probable
    #: of the three hypotheses, given the new rows; beforehand moved parts are a twentieth as probable as the others
    probabilities: dict[Verdict, float]
    #: tip error that comes on top of what the calibration states, rms over the workspace, if nothing is done, and if
    #: the zeros are set [m]
    off_if_kept: float
    off_if_zeroed: float
    #: what to add to the drives' readings to have their places, in the direction of the counters and the units of the
    #: joints, shape=(drives,) [m, rad]
    zeros: Array
    zero_sigmas: Array  #: its standard deviation [m, rad]
    detectable: Array  #: change of each zero that these rows show with 95 % probability, shape=(drives,) [m, rad]
    rows: int  #: number of rows
    contradiction: float  #: probability of residuals at least this large if the machine is unchanged
    contradiction_if_zeroed: float  #: the same if its zeros alone changed

    @property
    def is_forced(self) -> bool:
        """Whether the rows contradict the most probable hypothesis, so that it is not the verdict."""
        return self.verdict != max(self.probabilities, key=self.probabilities.__getitem__)

    @property
    def risk(self) -> float:
        """Probability that the verdict is wrong; if it is forced, that of residuals as large by chance."""
        if self.is_forced:
            zeros = self.probabilities["re-zero"] > self.probabilities["unchanged"]
            return self.contradiction_if_zeroed if zeros else self.contradiction
        return sum(other for verdict, other in self.probabilities.items() if verdict != self.verdict)

    def as_data(self) -> dict[str, Any]:
        """Return everything as plain data; keys end in their unit."""
        return {
            "verdict": self.verdict,
            "risk": self.risk,
            "probabilities": dict(self.probabilities),
            "tip_error_on_top_if_kept_m": self.off_if_kept,
            "tip_error_on_top_if_zeroed_m": self.off_if_zeroed,
            "zeros_m_rad": self.zeros.tolist(),
            "zero_sigmas_m_rad": self.zero_sigmas.tolist(),
            "detectable_zeros_m_rad": self.detectable.tolist(),
            "rows": self.rows,
            "probability_of_residuals_if_unchanged": self.contradiction,
            "probability_of_residuals_if_zeros_moved": self.contradiction_if_zeroed,
        }


@dataclass(frozen=True, eq=False)
class _Change:
    """A hypothesis with a size: standard deviations of the zeros and of the parameters' changes."""

    verdict: Verdict
    sigmas: Array
    weight: float  #: relative probability beforehand


@dataclass(frozen=True, eq=False)
class _Rows:
    """New rows about a calibrated machine whose zeros are somewhere, in units of their noise."""

    off: Array  #: residuals about the calibrated zeros, extended by the effects here, shape=(rows,)
    variance: Array  #: of these if nothing changed, shape=(rows, rows)
    effects: Array  #: of the zeros, then of the parameters, shape=(rows, drives + parameters)

    def evidence(self, change: _Change) -> float:
        """Return the logarithm of the evidence for a change."""
        (factor, _), _, solved = self._solved(change)
        return float(np.log(change.weight) - 0.5 * self.off @ solved - np.log(np.diag(factor)).sum())

    def moments(self, change: _Change) -> tuple[Array, Array]:
        """Return the mean and the mean square of a change's amounts, shape=(k,) and (k, k) [m, rad]."""
        factor, effects, solved = self._solved(change)
        gain = effects.T * change.sigmas[:, None]
        mean = gain @ solved
        spread = np.diag(change.sigmas**2) - gain @ scipy.linalg.cho_solve(factor, gain.T)
        return mean, spread + np.outer(mean, mean)

    def zeros(self, count: int) -> tuple[Array, Array]:
        """Return generalised least-squares estimates of so many zeros, and their standard deviations [m, rad]."""
        effects = self.effects[:, :count]
        weighted = np.linalg.solve(self.variance, effects)
        covariance = np.linalg.pinv(effects.T @ weighted, hermitian=True)
        return np.asarray(covariance @ (weighted.T @ self.off)), np.sqrt(np.diag(covariance))

    def contradiction(self, free: int) -> float:
        """Return the probability of residuals at least this large if nothing but so many zeros changed."""
        effects = self.effects[:, :free]
        left = self.off - effects @ self.zeros(free)[0]
        freedom = len(left) - int(np.linalg.matrix_rank(effects))
        return float(scipy.special.chdtrc(freedom, left @ np.linalg.solve(self.variance, left))) if freedom else 1.0

    def _solved(self, change: _Change) -> tuple[tuple[Array, bool], Array, Array]:
        effects = self.effects * change.sigmas
        factor = scipy.linalg.cho_factor(self.variance + effects @ effects.T, lower=True)
        return factor, effects, scipy.linalg.cho_solve(factor, self.off)


def recheck(calibration: Compensation | Path | str, measurements: Measurements, *, seed: int = 0) -> Recheck:
    """Judge from a few new rows whether a machine is still as calibrated.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.calibration.recheck import recheck
        >>> errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(1)
        >>> machine = pm.SimulatedMachine.random(errors, generator, everything=False)
        >>> commands = pm.reachable_poses(errors.robot, 48, generator).commands
        >>> rows = pm.Measurements.from_poses(commands, machine.measure(commands, generator))
        >>> calibration = pm.calibrate(rows[:40], errors, "lm")
        >>> recheck(calibration.compensation, rows[40:]).verdict
        'unchanged'

    Args:
        calibration: a method with parameters; or the folder of one, whose checksums are compared first.
        measurements: new rows, of any kind; a handful of poses.
        seed: of the poses over which the tool is judged.

    Raises:
        DescriptionError: the folder is no calibration, or was changed.
        InvalidValueError: the calibration has no parameters.
    """
    known = calibration if isinstance(calibration, Compensation) else read_compensation(calibration)
    if known.values is None or known.known_covariance is None:
        raise InvalidValueError("calibration", problem="has no parameters", expected="one of a method with lm")
    # temperatures and loads that the calibration does not depend on are no reason to refuse the rows
    learned = () if known.learned is None else known.learned.inputs.conditions
    conditions = known.with_usual_conditions(
        {
            name: values
            for name, values in measurements.conditions.items()
            if name in learned or (known.bears_wrenches and is_wrench(name))
        }
    )
    robot = known.errors.robot
    count = len(robot.commands)
    hypotheses = _hypotheses([command.unit for command in robot.commands], known.errors.tolerances)
    re_zero = [change for change in hypotheses if change.verdict == "re-zero"]
    rows = first = _rows(known, measurements, conditions, np.zeros(count))
    zeros = np.zeros(count)
    for _ in range(_ROUNDS):
        shares = scipy.special.softmax([rows.evidence(change) for change in re_zero])
        best = np.sum([share * rows.moments(c)[0] for share, c in zip(shares, re_zero, strict=True)], axis=0)
        if np.abs(rows.effects[:, :count] @ (best[:count] - zeros)).max(initial=0.0) < _SETTLED:
            break
        try:
            rows, zeros = _rows(known, measurements, conditions, best[:count]), best[:count]
        except PM3DofError:  # no machine with such zeros: parts moved
            break
    weights = scipy.special.softmax([rows.evidence(change) for change in hypotheses])
    verdicts = np.array([change.verdict for change in hypotheses])
    probabilities: dict[Verdict, float] = {
        verdict: min(1.0, float(weights[verdicts == verdict].sum())) for verdict in get_args(Verdict)
    }
    mean, moments = np.zeros(len(best)), np.zeros((len(best), len(best)))
    for weight, change in zip(weights, hypotheses, strict=True):
        if weight > _NEGLIGIBLE:
            own, square = rows.moments(change)
            mean, moments = mean + weight * own, moments + weight * square
    zeroed = moments - np.outer(best, mean) - np.outer(mean, best) + np.outer(best, best)
    tested = reachable_poses(known.errors.robot, _POSES, np.random.default_rng(seed))
    tip = np.concatenate(_effects(known, known.model_poses(tested)), axis=2) * known.weights[:, None]
    tip_square = np.einsum("nij,nik->jk", tip, tip) / len(tip)
    kept, set_ = (float(np.sqrt(max(0.0, np.sum(tip_square * each)))) for each in (moments, zeroed))
    against = {"unchanged": first.contradiction(0), "re-zero": rows.contradiction(count)}
    verdict = max(probabilities, key=probabilities.__getitem__)
    if against.get(verdict, 1.0) < _UNLIKELY:
        verdict = "recalibrate"
    found, sigmas = rows.zeros(count)
    shown = _NOTICED * sigmas
    return Recheck(verdict, probabilities, kept, set_, found, sigmas, shown, len(measurements), *against.values())


def _rows(known: Compensation, measurements: Measurements, conditions: Conditions, zeros: Array) -> _Rows:
    """Return rows about a calibrated machine with other zeros; raises as :meth:`Compensation.poses`."""
    robot, seen = known.errors.robot, measurements.seen
    scales = np.abs([command.scale for command in robot.commands])
    machine = known.poses(robot.forward(measurements.commands + scales * zeros), conditions)

    def rows(motions: Array) -> Array:
        found = measurements.derivatives(machine, motions)
        return np.asarray((np.where(seen[:, :, None], found, 0.0) / measurements.sigmas[:, :, None])[seen])

    off = (measurements.residuals(machine) / measurements.sigmas)[seen]
    joints = tuple(measurements.joints)
    drives, changes = _effects(known, machine, joints)
    nuisances = Nuisances.from_measurements(measurements, tuple(command.unit for command in robot.commands))
    beside = nuisances.motions(measurements, machine, drives) * nuisances.scales
    beside = beside * np.minimum(nuisances.sigmas, _LARGEST_SIGMA)
    covariance = known.known_covariance
    assert covariance is not None
    calibrated = np.concatenate([changes, with_joints(datum_motions(machine), len(joints))], axis=2)
    calibrated = calibrated[:, :, : len(covariance)] @ _root(covariance)
    scatter = with_joints(_scatter(known, machine, measurements), len(joints))
    usual = rows(np.concatenate([calibrated, scatter, beside], axis=2))
    effects = rows(np.concatenate([drives, changes], axis=2))
    return _Rows(off + effects[:, : len(zeros)] @ zeros, np.eye(len(off)) + usual @ usual.T, effects)


def add_to_history(directory: Path | str, entry: dict[str, Any]) -> Path:
    """Append an entry to the history of a calibration's folder, atomically; return the file.

    Raises:
        DescriptionError: the history there cannot be read.
        OutputError: it cannot be written.
    """
    path = Path(directory) / HISTORY
    return write_text_atomically(path, (read_text(path) if path.is_file() else "") + json.dumps(entry) + "\n")


def read_history(directory: Path | str) -> list[dict[str, Any]]:
    """Return the entries of the history of a calibration's folder, oldest first; none if it has none.

    Raises:
        DescriptionError: a line is not JSON.
    """
    path = Path(directory) / HISTORY
    try:
        return [json.loads(line) for line in read_text(path).splitlines()] if path.is_file() else []
    except (ValueError, RecursionError) as error:
        raise DescriptionError(path, "history", f"expected one JSON object a line ({error})") from error


def _effects(known: Compensation, poses: Poses, joints: tuple[str, ...] = ()) -> tuple[Array, Array]:
    """Return the motions of tool and joints by the zeros and by the parameters, shape=(n, 6 + joints, k) each."""
    found = sensitivities(known.errors, poses, known.values, joints=joints)
    return tool_motions_by_drives(poses, found.commands), found.errors


def _root(covariance: Array) -> Array:
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(values, 0.0)))


def _scatter(known: Compensation, machine: Poses, measurements: Measurements) -> Array:
    """Return motions of one standard deviation of the scatter, the same for all rows of a visit, shape=(n, 6, k)."""
    weights = known.weights
    inverse = np.divide(1.0, weights, out=np.zeros_like(weights), where=weights > 0.0)  # nothing known of the others
    first, numbers = measurements.first_rows, measurements.visit_numbers
    covariances = known.scatter.covariances(weighted_control(machine[first], known.eta)) * np.outer(inverse, inverse)
    motions = np.zeros((len(measurements), 6, 6 * len(first)))
    for visit, covariance in enumerate(covariances):
        motions[numbers == visit, :, 6 * visit : 6 * visit + 6] = _root(covariance)
    return motions


def _hypotheses(units: Sequence[str], tolerances: Array) -> list[_Change]:
    sizes = np.column_stack([_ZEROS[unit] for unit in units])
    found: list[tuple[Verdict, Array, float]] = [("unchanged", np.zeros(len(units)), 0.0)]
    found += [("re-zero", size, 0.0) for size in sizes]
    found += [("recalibrate", size, factor) for size in sizes for factor in _CHANGES]
    counts = Counter(verdict for verdict, *_ in found)
    return [
        _Change(verdict, np.concatenate([size, factor * tolerances]), _BEFOREHAND[verdict] / counts[verdict])
        for verdict, size, factor in found
    ]
