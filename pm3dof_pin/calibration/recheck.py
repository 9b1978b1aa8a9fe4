"""Is a calibration still true? The last one as prior, and a few new rows.

Three hypotheses, each with what the one before it has, explain the residuals r of the new rows about the calibrated
machine, in units of their noise:

    unchanged      r = N(0, V),  V = 1 + A P A^T + noise of what else the rows depend on + scatter,
    re-zero        V + z^2 Z Z^T: the drives' zeros moved,
    recalibrate    V + z^2 Z Z^T + s^2 A T^2 A^T: parts moved, too, by s tolerances: all of them, or those of one place,

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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from pm3dof_pin.calibration.compensation import Compensation, Conditions
from pm3dof_pin.calibration.folder import HISTORY, read_compensation
from pm3dof_pin.calibration.linearisation import tool_motions_by_drives
from pm3dof_pin.errors.command_correction import weighted_control
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, PM3DofError
from pm3dof_pin.files import read_text, write_text_atomically
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.measurements import Measurements, with_joints
from pm3dof_pin.measuring.nuisances import Nuisances, datum_motions
from pm3dof_pin.measuring.wrenches import is_wrench
from pm3dof_pin.typing import Array, Mask

Verdict = Literal["unchanged", "re-zero", "recalibrate"]
_VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

_ZEROS = {"m": np.geomspace(3e-6, 3e-2, 17), "rad": np.geomspace(1e-5, 1e-1, 17)}
"""Sizes of changes of zeros, as many for each unit of a drive [m, rad]."""
_CHANGES = np.geomspace(0.1, 30.0, 7)  # sizes of other changes, in tolerances
_FEWER = 8  # sizes of zeros that move beside one part, or beside one zero that moves farther
_BEFOREHAND: dict[Verdict, float] = {"unchanged": 1.0, "re-zero": 1.0, "recalibrate": 0.05}  # relative probabilities
_NEGLIGIBLE = 1e-4  # probability of a change that does not count
_ROUNDS, _SETTLED = 8, 0.01  # of effects at the zeros found; in standard deviations of a row
_UNLIKELY = 5e-3  # a verdict that the rows contradict with this probability does not stand
_NOTICED = scipy.special.ndtri(0.95) + scipy.special.ndtri(0.975)  # standard errors that are noticed with 95 %
_SHOWN = 0.95  # probability
_PART_SIZES = np.geomspace(5e-3, 10.0, 12)  # of tip errors by one part, in those by the tolerances of all
_DRAWN = 50  # parts for each of them
_IDLE = 1e-3  # of these: a parameter whose tolerance leaves less beyond new zeros is a zero, not a part
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
    #: tip error beyond what new zeros leave, rms over the workspace, from which on one moved part is called
    #: "recalibrate" with 95 % probability; infinite if it never is [m]
    detectable_parts: float
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
            "detectable_parts_m": self.detectable_parts if np.isfinite(self.detectable_parts) else None,
            "rows": self.rows,
            "probability_of_residuals_if_unchanged": self.contradiction,
            "probability_of_residuals_if_zeros_moved": self.contradiction_if_zeroed,
        }


@dataclass(frozen=True, eq=False)
class _Changes:
    """Hypotheses that move the same parts, if any, by several sizes: standard deviations of zeros and parameters."""

    verdict: Verdict
    zeros: Array  #: of the drives' zeros, shape=(n, drives) [m, rad]
    parts: Array  #: tolerances of the parameters that move, 0 of others, shape=(parameters,) [m, rad]
    sizes: Array  #: of the parameters' changes, in these tolerances, shape=(n,)
    share: float  #: probability beforehand of all of them, relative to that of the verdict

    @property
    def log_weight(self) -> float:
        """The logarithm of the relative probability beforehand of each."""
        return float(np.log(_BEFOREHAND[self.verdict] * self.share / len(self.sizes)))


@dataclass(frozen=True, eq=False)
class _Rows:
    """New rows about a calibrated machine whose zeros are somewhere, independent and in units of their noise."""

    #: residuals about the calibrated zeros, extended by the effects here, shape=(rows,); or of several such machines,
    #: shape=(rows, machines), of which evidence and contradiction are told one by one
    off: Array
    effects: Array  #: of the zeros, then of the parameters, shape=(rows, drives + parameters)

    def judged(self, hypotheses: Sequence[_Changes]) -> Iterator[tuple[_Judged, int]]:
        """Give each hypothesis: those that move the same parts, as judged by the rows, and its number among these."""
        for changes in hypotheses:
            judged = _Judged(self, changes)
            yield from ((judged, number) for number in range(len(changes.sizes)))

    def evidence(self, hypotheses: Sequence[_Changes]) -> Array:
        """Return the logarithm of the evidence for each hypothesis, shape=(hypotheses, ...)."""
        return np.stack([judged.evidence(number) for judged, number in self.judged(hypotheses)])

    def zeros(self, count: int) -> tuple[Array, Array]:
        """Return least-squares estimates of so many zeros, and their standard deviations [m, rad]."""
        effects = self.effects[:, :count]
        covariance = np.linalg.pinv(effects.T @ effects, hermitian=True)
        return np.asarray(covariance @ (effects.T @ self.off)), np.sqrt(np.diag(covariance))

    def contradiction(self, free: int) -> Array:
        """Return the probability of residuals at least this large if nothing but so many zeros changed."""
        effects = self.effects[:, :free]
        left = self.off - effects @ self.zeros(free)[0]
        freedom = len(left) - int(np.linalg.matrix_rank(effects))
        squares = np.sum(left * left, axis=0)
        return np.asarray(scipy.special.chdtrc(freedom, squares)) if freedom else np.ones_like(squares)


class _Judged:
    """Hypotheses that move the same parts, judged by rows, in an orthonormal basis of what they move."""

    def __init__(self, rows: _Rows, changes: _Changes) -> None:
        self.changes = changes
        self._count = rows.effects.shape[1]
        self._zeros, self._parts = np.flatnonzero(changes.zeros.any(axis=0)), np.flatnonzero(changes.parts)
        moving = np.append(self._zeros, changes.zeros.shape[1] + self._parts)
        basis, effects = np.linalg.qr(rows.effects[:, moving])
        self._off = basis.T @ rows.off
        self._squares_beyond = np.sum(rows.off**2, axis=0) - np.sum(self._off**2, axis=0)
        self._moving, self._effects = moving, effects
        by_parts = effects[:, len(self._zeros) :] * changes.parts[self._parts]
        self._covariance_by_parts = by_parts @ by_parts.T

    def evidence(self, number: int) -> Array:
        """Return the logarithm of the evidence for one of the changes, shape=(...)."""
        factor = self._factor(number)
        squares = np.sum(scipy.linalg.solve_triangular(factor, self._off, lower=True) ** 2, axis=0)
        logarithm = self.changes.log_weight - np.log(np.diag(factor)).sum()
        return np.asarray(logarithm - 0.5 * (self._squares_beyond + squares))

    def mean(self, number: int) -> Array:
        """Return the mean of the amounts of one of the changes, shape=(drives + parameters,) [m, rad]."""
        solved = scipy.linalg.cho_solve((self._factor(number), True), self._off)
        mean = np.zeros(self._count)
        mean[self._moving] = self._sigmas(number) ** 2 * (self._effects.T @ solved)
        return mean

    def moments(self, number: int) -> tuple[Array, Array]:
        """Return the mean and the mean square of the amounts of one of the changes, shape=(k,) and (k, k) [m, rad]."""
        mean, variances = self.mean(number), self._sigmas(number) ** 2
        gain = self._effects.T * variances[:, None]
        explained = gain @ scipy.linalg.cho_solve((self._factor(number), True), gain.T)
        square = np.outer(mean, mean)
        square[np.ix_(self._moving, self._moving)] += np.diag(variances) - explained
        return mean, square

    def _sigmas(self, number: int) -> Array:
        """Return the standard deviations of what moves, shape=(moving,) [m, rad]."""
        by_parts = self.changes.sizes[number] * self.changes.parts[self._parts]
        return np.append(self.changes.zeros[number, self._zeros], by_parts)

    def _factor(self, number: int) -> Array:
        """Return the lower Cholesky factor of the covariance of the residuals with one of the changes."""
        by_zeros = self._effects[:, : len(self._zeros)] * self.changes.zeros[number, self._zeros]
        by_parts = self.changes.sizes[number] ** 2 * self._covariance_by_parts
        return np.asarray(np.linalg.cholesky(np.eye(len(by_zeros)) + by_zeros @ by_zeros.T + by_parts), dtype=float)


def _by_verdict(weights: Array, hypotheses: Sequence[_Changes]) -> Array:
    """Return the sums of the weights of hypotheses, shape=(k, ...), over each verdict, shape=(3, ...)."""
    verdicts = np.array([changes.verdict for changes in hypotheses for _ in changes.sizes])
    return np.stack([weights[verdicts == verdict].sum(axis=0) for verdict in _VERDICTS])


def _verdict(probabilities: Array, against_unchanged: Array, against_zeros: Array) -> NDArray[np.intp]:
    """Return the number of the verdict on each machine: the most probable, or the last if the rows contradict it.

    Probabilities are those of the verdicts, shape=(3, ...), and those of residuals as large under the first two,
    shape=(...).
    """
    most = probabilities.argmax(axis=0)
    against = np.choose(most, [against_unchanged, against_zeros, np.ones_like(against_zeros)])
    return np.where(against < _UNLIKELY, len(_VERDICTS) - 1, most)


def _left_by_zeros(tip_square: Array, tolerances: Array) -> Array:
    """Return the tip error that new zeros leave of each part moved by a unit, shape=(parameters,) [m/m, m/rad].

    0 for parts that are nearly zeros of drives, such as the length of a strut that is driven.
    """
    drives = len(tip_square) - len(tolerances)
    crossed = tip_square[:drives, drives:]
    by_zeros = np.sum(crossed * (np.linalg.pinv(tip_square[:drives, :drives], hermitian=True) @ crossed), axis=0)
    left = np.sqrt(np.maximum(np.diag(tip_square)[drives:] - by_zeros, 0.0))
    return np.where(left * tolerances > _IDLE * np.linalg.norm(left * tolerances), left, 0.0)


def _detectable_parts(
    rows: _Rows, hypotheses: Sequence[_Changes], left: Array, tolerances: Array, generator: np.random.Generator
) -> float:
    """Return the tip error beyond new zeros from which on one moved part is called so with 95 % probability [m].

    By simulation: for tip errors of increasing size, parts are drawn, moved that far, and judged by such rows. What new
    zeros leave of each is given by :func:`_left_by_zeros`.
    """
    parts, usual = np.flatnonzero(left), float(np.linalg.norm(left * tolerances))
    if not parts.size:
        return np.inf
    drives = rows.effects.shape[1] - len(tolerances)
    drawn = generator.choice(parts, (len(_PART_SIZES), _DRAWN))
    amounts = usual * _PART_SIZES[:, None] / left[drawn]
    moved = (rows.effects[:, drives + drawn] * amounts).reshape(len(rows.off), -1)
    drawn_rows = replace(rows, off=moved + generator.standard_normal(moved.shape))
    probabilities = _by_verdict(scipy.special.softmax(drawn_rows.evidence(hypotheses), axis=0), hypotheses)
    verdicts = _verdict(probabilities, drawn_rows.contradiction(0), drawn_rows.contradiction(drives))
    called = (verdicts == _VERDICTS.index("recalibrate")).reshape(drawn.shape)
    shown = np.maximum.accumulate(called.mean(axis=1))
    if shown[-1] < _SHOWN:
        return np.inf
    return float(usual * np.exp(np.interp(_SHOWN, shown, np.log(_PART_SIZES))))


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
    tested = reachable_poses(robot, _POSES, np.random.default_rng(seed))
    tip = np.concatenate(_effects(known, known.model_poses(tested)), axis=2) * known.weights[:, None]
    tip_square = np.einsum("nij,nik->jk", tip, tip) / len(tip)
    left = _left_by_zeros(tip_square, known.errors.tolerances)
    hypotheses = _hypotheses([command.unit for command in robot.commands], known.errors, left > 0.0)
    re_zero = [changes for changes in hypotheses if changes.verdict == "re-zero"]
    rows = first = _rows(known, measurements, conditions, np.zeros(count))
    zeros = np.zeros(count)
    for _ in range(_ROUNDS):
        shares = scipy.special.softmax(rows.evidence(re_zero))
        best = shares @ np.array([judged.mean(number) for judged, number in rows.judged(re_zero)])
        if np.abs(rows.effects[:, :count] @ (best[:count] - zeros)).max(initial=0.0) < _SETTLED:
            break
        try:
            rows, zeros = _rows(known, measurements, conditions, best[:count]), best[:count]
        except PM3DofError:  # no machine with such zeros: parts moved
            break
    weights = scipy.special.softmax(rows.evidence(hypotheses))
    probabilities = np.minimum(1.0, _by_verdict(weights, hypotheses))
    mean, moments = np.zeros(len(best)), np.zeros((len(best), len(best)))
    counted = weights[weights > _NEGLIGIBLE].sum()  # of many, those that do not count are not nothing together
    for weight, (judged, number) in zip(weights, rows.judged(hypotheses), strict=True):
        if weight > _NEGLIGIBLE:
            own, square = judged.moments(number)
            mean, moments = mean + weight / counted * own, moments + weight / counted * square
    zeroed = moments - np.outer(best, mean) - np.outer(mean, best) + np.outer(best, best)
    kept, set_ = (float(np.sqrt(max(0.0, np.sum(tip_square * each)))) for each in (moments, zeroed))
    against = first.contradiction(0), rows.contradiction(count)
    verdict = _VERDICTS[int(_verdict(probabilities, *against))]
    found, sigmas = rows.zeros(count)
    generator = np.random.default_rng(seed)
    parts, shown = _detectable_parts(rows, hypotheses, left, known.errors.tolerances, generator), _NOTICED * sigmas
    amounts = kept, set_, found, sigmas, shown, parts
    each = dict(zip(_VERDICTS, probabilities.tolist(), strict=True))
    return Recheck(verdict, each, *amounts, len(measurements), *map(float, against))


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
    off = off + effects[:, : len(zeros)] @ zeros
    factor = np.linalg.cholesky(np.eye(len(off)) + usual @ usual.T)
    return _Rows(*(scipy.linalg.solve_triangular(factor, each, lower=True) for each in (off, effects)))


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


def _hypotheses(units: Sequence[str], errors: GeometricErrors, is_part: Mask) -> list[_Changes]:
    """Return the changes that are weighed: one zero or place far more than the others is as likely as all alike.

    Parameters that are no parts but zeros of drives, by the mask, do not count as moved alone.
    """
    alike = np.column_stack([_ZEROS[unit] for unit in units])
    unmoved, kept = np.zeros((1, len(units))), np.zeros(len(errors))
    beside = np.vstack([unmoved, alike[::_FEWER]])
    places = np.array([parameter.place for parameter in errors.parameters])
    of_one = [errors.tolerances * (is_part & (places == place)) for place in dict.fromkeys(places[is_part])]
    one_zero = [np.where(one, size, other) for size in alike for other in beside for one in np.eye(len(units)) > 0.0]

    def moving(zeros: Array, parts: Array, share: float) -> _Changes:
        return _Changes("recalibrate", np.repeat(zeros, len(_CHANGES), 0), parts, np.tile(_CHANGES, len(zeros)), share)

    return [
        _Changes("unchanged", unmoved, kept, np.zeros(1), 1.0),
        _Changes("re-zero", alike, kept, np.zeros(len(alike)), 0.5),
        _Changes("re-zero", np.array(one_zero), kept, np.zeros(len(one_zero)), 0.5),
        moving(alike, errors.tolerances, 0.5),
        *(moving(beside, one, 0.5 / len(of_one)) for one in of_one),
    ]
