"""How good a calibration is: on measurements it was not shown, and over the workspace as far as it knows itself."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.calibration.calibrate import LEAST_POSES, Calibration, compensation_from
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.calibration.pseudo_error import control_inverse, pseudo_errors, seen_errors
from pm3dof_pin.calibration.rms_interval import COVERAGE, excess_interval
from pm3dof_pin.calibration.scatter import Scatter, scatter_of
from pm3dof_pin.errors.command_correction import nearest_poses, weighted_control
from pm3dof_pin.errors.error_map import section_grid
from pm3dof_pin.errors.normal_vectors import norm_quantiles
from pm3dof_pin.errors.pose_error import pose_difference, tip_error, weighted_energy
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.registration import register
from pm3dof_pin.typing import Array, Indices, Mask

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.grid import Grid
    from pm3dof_pin.kinematics.robot import Robot

logger = logging.getLogger(__name__)

_FOLDS = 5
_MOVED = 0.01  # [m, rad]: further than errors of a machine move its base
SMOOTH = 1.5
"""Noise factor from which what parameters leave is taken to go on from pose to pose, and not to scatter."""

_FLOOR_SEEN = 1e-3  # of whole poses no direction is unseen, but near a singular pose none of use can be tiny


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of measured poses, one for each visit, as far as the measurements show them. Outliers are left out.

    Attributes:
        rows: which measurements were judged by, shape=(n,).
        before: tip error of the machine as described, shape=(visits,) [m].
        after: tip error with the corrected commands, the measurements' noise included, shape=(visits,) [m].
        floor: tip error with the best commands, the measurements' noise included, shape=(visits,) [m].
        noise: tip error that the measurements' noise amounts to, root mean square, shape=(visits,) [m].
        excess: by how much the corrected commands are to be expected to miss the best ones, root mean square over the
            drives' joints, shape=(visits,) [m, rad]: by what is uncertain about parameters and learned parts, seen or
            not, and by the scatter beyond that. What is seen of it has more noise than there is excess. NaN where a
            method without parameters, which say how uncertain that is, does not see all motions of the drives.
        excess_interval: the root mean square of that over visits, of this machine, is between these with the
            probability of 95 %, see :mod:`pm3dof_pin.calibration.rms_interval`; None for a method that learns, near
            singular poses, and from the noise factor :data:`SMOOTH` on.
        scatter: what the corrected machine misses beyond what is known to be uncertain.
        within: part of the visits at which what is left stays below the bound of :data:`COVERAGE`.
        energies: E of (8.15), E_xyz + eta E_orientation, of `before`, `after` and `floor`, shape=(3, visits) [m].
    """

    rows: Indices
    before: Array
    after: Array
    floor: Array
    noise: Array
    excess: Array
    excess_interval: tuple[float, float] | None
    scatter: Scatter
    within: float
    energies: Array


def held_out_errors(calibration: Calibration) -> HeldOut:
    """Judge a calibration by cross-validation: the same method, shown four fifths of the poses at a time.

    Measurements at the same commands, of several targets or repeated, are hidden together. The instrument's frame and
    the targets' offsets are those that the others tell.

    Raises:
        InvalidValueError: too few poses.
    """
    options, errors = calibration.options, calibration.compensation.errors
    rows = _trusted_rows(calibration)
    measurements = calibration.measurements[rows]
    numbers = measurements.pose_numbers
    count = int(numbers.max(initial=-1)) + 1
    if count <= LEAST_POSES:
        raise InvalidValueError("measurements", f"{count} poses", f"more than {LEAST_POSES} for a cross-validation")
    folds = np.random.default_rng(options.seed).permutation(np.arange(count) % min(_FOLDS, count))[numbers]
    parts, starts = [], []
    for fold in range(int(folds.max()) + 1):
        shown, hidden = np.flatnonzero(folds != fold), np.flatnonzero(folds == fold)
        found = identify(
            measurements[shown],
            errors,
            prior=calibration.identification.prior,
            prior_error=calibration.identification.prior_error,
            loss=options.loss,
            nuisances=calibration.identification.nuisances,
            start=calibration.identification,
        )
        compensation = compensation_from(found.settled, errors, options, found if options.identifies else None)
        part = measurements[hidden]
        parts.append(_judged(compensation, found.settle(part), calibration.compensation))
        starts.append(hidden[np.unique(part.visit_numbers, return_index=True)[1]])
    units = [command.unit for command in errors.robot.commands]
    scores = _Scores.joined(parts, np.argsort(np.concatenate(starts))).that_show_the_tool()
    seen = (scores.missed, scores.covariances, scores.shown, scores.control, units)
    return _together(calibration, rows, scores, scatter_of(*seen), scatter_of(*seen, least=1.0))


def validated_errors(calibration: Calibration, measurements: Measurements) -> HeldOut:
    """Judge a calibration by other measurements, in the base's axes or from an instrument with a frame of its own.

    That is the one identified, or where it plainly stands elsewhere, one that is found from them alone.
    """
    settled = calibration.identification.settle(_of_their_own_station(calibration, measurements))
    compensation = calibration.compensation
    scores = _judged(compensation, settled, compensation)
    scatter = compensation.scatter
    return _together(calibration, np.arange(len(measurements)), scores.that_show_the_tool(), scatter, scatter)


def tip_interval(calibration: Calibration, wanted: Poses) -> tuple[float, float] | None:
    """Return :meth:`~pm3dof_pin.calibration.compensation.Compensation.rms_interval`; None from :data:`SMOOTH` on."""
    scattered = calibration.identification.noise_factor < SMOOTH
    return calibration.compensation.rms_interval(wanted) if scattered else None


def _of_their_own_station(calibration: Calibration, measurements: Measurements) -> Measurements:
    """Return measurements of an instrument that has been moved in the base that the calibrated machine gives them."""
    first, second = calibration.measurements.registration, measurements.registration
    if first is None or second is None or not measurements.seen.all():
        return measurements
    difference = pose_difference(first.base, second.base)
    if np.linalg.norm(difference[:3]) < _MOVED and np.linalg.norm(difference[3:]) < _MOVED:
        return measurements
    compensation = calibration.compensation
    reached = compensation.poses(compensation.errors.robot.forward(measurements.commands), measurements.conditions)
    points = reached.positions + np.einsum("nij,nj->ni", reached.rotations, measurements.points)
    rotations = (None, None) if measurements.rotations is None else (measurements.rotations, reached.rotations)
    found = register(measurements.positions, points, *rotations, eta=compensation.eta)
    logger.warning(
        "the validation was measured from another station, %.3g m away: the base is found from it alone, and what "
        "moves everything alike is not judged",
        float(np.linalg.norm(difference[:3])),
    )
    return replace(
        measurements,
        positions=found.positions(measurements.positions),
        rotations=None if measurements.rotations is None else found.rotations(measurements.rotations),
        registration=None,
    )


@dataclass(frozen=True, eq=False)
class _Scores:
    """Of each visit what it is judged by.

    Attributes:
        sizes: before, after, floor, noise, E of the first three, shape=(7, visits).
        missed: what predicted poses miss, tip-weighted, shape=(visits, 6) [m].
        covariances: what is known to be uncertain of that, shape=(visits, 6, 6) [m^2].
        shown: the directions that are shown, shape=(visits, 6, 6).
        control: tip-weighted motion by the drives' joints, shape=(visits, 6, drives).
        uncertain: of poses that the calibration from all measurements predicts, shape=(visits, 6, 6) [m^2].
        effects: what that moves for parameters a standard deviation off, in all independent directions, shape=(visits,
            6, directions) [m]; without any for a method that learns.
    """

    sizes: Array
    missed: Array
    covariances: Array
    shown: Array
    control: Array
    uncertain: Array
    effects: Array

    def that_show_the_tool(self) -> _Scores:
        """Return those of visits at which something of the tool was seen; all of them if it never was."""
        told = self.shown.any(axis=(1, 2))
        return self if not told.any() else _Scores(self.sizes[:, told], *(values[told] for values in self._of_visits))

    @property
    def _of_visits(self) -> tuple[Array, ...]:
        return self.missed, self.covariances, self.shown, self.control, self.uncertain, self.effects

    @classmethod
    def joined(cls, parts: Sequence[_Scores], order: Indices) -> _Scores:
        sizes = np.concatenate([part.sizes for part in parts], axis=1)[:, order]
        others = zip(*(part._of_visits for part in parts), strict=True)
        return cls(sizes, *(np.concatenate(values)[order] for values in others))


def _judged(compensation: Compensation, measurements: Measurements, final: Compensation) -> _Scores:
    if compensation.values is not None:
        measurements = compensation.without_loads(measurements)
    visits, eta = measurements.visits, compensation.eta
    nominal = compensation.errors.robot.forward(visits.commands)
    predicted = compensation.deviations(nominal, visits.conditions)
    true = pseudo_errors(measurements, nominal, eta)
    best = pseudo_errors(measurements, nominal, eta, seen=_FLOOR_SEEN).left if true.whole else true.left
    reached = compensation.errors.robot.forward(nominal.commands + predicted, guess=nominal.q)
    judged = (true.before, seen_errors(measurements, reached, eta).errors, best)
    sizes = np.array(
        [
            *(np.linalg.norm(errors, axis=1) for errors in judged),
            np.sqrt(np.einsum("nii->n", true.seen.covariances)),
            *map(weighted_energy, judged),
        ]
    )
    model = compensation.poses(nominal, visits.conditions)
    left = seen_errors(measurements, model, eta)
    uncertain = compensation.covariances(model, visits.conditions)
    known = left.covariances + left.shown @ uncertain @ left.shown
    of_all = final.covariances(reached := final.model_poses(nominal), visits.conditions)
    effects = final.standard_effects(reached)
    control = weighted_control(nominal, eta)
    if compensation.values is None:
        blind = np.linalg.matrix_rank(control_inverse(true.control)) < control.shape[2]
        of_all[blind] = np.nan
    return _Scores(sizes, left.errors, known, left.shown, control, of_all, effects)


def _together(calibration: Calibration, rows: Indices, scores: _Scores, scatter: Scatter, sure: Scatter) -> HeldOut:
    """Return errors with the scatter that bounds allow for, and the excess with that of which there is no doubt."""
    before, after, floor, noise, *energies = scores.sizes
    gains, left = control_inverse(scores.control), sure.covariances(scores.control)
    excess = np.sqrt(np.einsum("nij,njk,nik->n", gains, scores.uncertain + left, gains) / gains.shape[1])
    spread = scores.covariances + scores.shown @ scatter.covariances(scores.control) @ scores.shown
    bounds = norm_quantiles(np.zeros_like(scores.missed), spread, COVERAGE)
    within = float(np.mean(np.linalg.norm(scores.missed, axis=1) <= bounds))
    scattered = calibration.identification.noise_factor < SMOOTH
    interval = excess_interval(scores.effects, sure, scores.control) if scattered else None
    return HeldOut(rows, before, after, floor, noise, excess, interval, scatter, within, np.array(energies))


def chance_of_harm(calibration: Calibration) -> float:
    """Return the probability that corrected commands are worse than uncorrected ones, by what the parameters tell.

    See :mod:`pm3dof_pin.calibration.caution`. 0 for a method without parameters.
    """
    gain, values = calibration.gain, calibration.compensation.values
    return 0.0 if gain is None or values is None else gain.chance_of_harm(values)


def part_corrected(calibration: Calibration) -> float:
    """Return how much of the correction that the parameters would be is sure enough to be made, 1 for all of it."""
    gain, values = calibration.gain, calibration.compensation.values
    return 1.0 if gain is None or values is None else gain.part(values)


def can_be_judged(calibration: Calibration) -> bool:
    """Tell whether there are enough poses for :func:`held_out_errors`, each part of them with enough to learn from."""
    numbers = calibration.measurements[_trusted_rows(calibration)].pose_numbers
    return int(numbers.max(initial=-1)) > LEAST_POSES


def _trusted_rows(calibration: Calibration) -> Indices:
    return np.setdiff1d(np.arange(len(calibration.measurements)), calibration.identification.outliers)


@dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """Tip errors over two coordinates, the others in the middle of their ranges; NaN beyond the limits.

    Attributes:
        names: the two coordinates.
        units: their units, "rad" or "m".
        coordinates: their values, shape=(points,) each [m, rad].
        before: tip error with the commands of the description, shape=(points, points) [m].
        after: tip error expected with corrected commands [m].
        floor: part of `before` that no command corrects, as the calibrated model has it [m]; None without parameters,
            which alone tell it.
        within: from points of the section, shape=(n, 2), to whether they are within the limits; its exact edge.
    """

    names: tuple[str, str]
    units: tuple[str, str]
    coordinates: tuple[Array, Array]
    before: Array
    after: Array
    floor: Array | None
    within: Callable[[Array], Mask] | None = None


def workspace_errors(calibration: Calibration, points: int = 41) -> WorkspaceErrors | None:
    """Compute errors over the first two coordinates with ranges, or None, under the mean measured conditions."""
    compensation = calibration.compensation
    robot = compensation.errors.robot
    grid = section_grid(robot, points=points)
    if grid is None or len(grid.dims) < 2:
        return None
    poses = robot.solve(grid, on_failure="nan")
    within = poses.within_limits
    conditions = {name: float(values.mean()) for name, values in calibration.measurements.conditions.items()}
    used = () if compensation.learned is None else compensation.learned.inputs.conditions
    known = {name: conditions[name] for name in used}
    expected = compensation.compensate(poses[within], known, on_failure="nan").predicted_error
    # next to singular poses the machine may not get as far as its description
    taken = np.isfinite(expected) & compensation.model_poses(poses[within], "nan").solved
    inside = tuple(indices[taken] for indices in np.nonzero(within))
    nominal, expected = poses[inside], expected[taken]
    seen = compensation.poses(nominal, conditions).transforms

    def spread(values: Array) -> Array:
        field = np.full(grid.shape, np.nan)
        field[inside] = values
        return field

    floor = None
    if compensation.values is not None:
        nearest = nearest_poses(nominal, seen, compensation.eta, on_failure="nan").transforms
        floor = spread(tip_error(pose_difference(nearest, seen), compensation.eta))
    first, second = grid.dims
    return WorkspaceErrors(
        (first, second),
        (robot.coordinate(first).unit, robot.coordinate(second).unit),
        (grid.axes[first], grid.axes[second]),
        spread(tip_error(pose_difference(nominal.transforms, seen), compensation.eta)),
        spread(expected),
        floor,
        _within(robot, grid),
    )


def _within(robot: Robot, grid: Grid) -> Callable[[Array], Mask]:
    """Return the limits over the coordinates of a grid, the others as they stand in it."""
    fixed = np.array([grid.fixed.get(coordinate.name, 0.0) for coordinate in robot.coordinates])
    columns = [[coordinate.name for coordinate in robot.coordinates].index(name) for name in grid.dims]

    def within(points: Array) -> Mask:
        values = np.tile(fixed, (len(points), 1))
        values[:, columns] = points
        return robot.solve(values, on_failure="nan").within_limits

    return within
