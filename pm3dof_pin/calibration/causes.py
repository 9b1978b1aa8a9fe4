"""Why measurements do not fit a machine: the usual mistakes are tried one after another.

Each is a change of the measurements (:mod:`pm3dof_pin.calibration.mistakes`). The machine as described, which differs
from the real one by tolerances at most, is compared with the measurements before and after the change; the
instrument's base is located again if that was requested. A mistake that explains most of the misfit is likely the one
that was made; of several that explain as much, the simplest. Mistakes that cannot be distinguished from it are named
with it: if the platform never turns, another tool point is equivalent to another frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from pm3dof_pin.calibration.mistakes import (
    Mistake,
    explained_by,
    near_their_ranges,
    of_a_change,
    usual_mistakes,
)
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.calibration.wrong_columns import wrong_columns
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference, tip_error
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.typing import Mask

_EXPLAINS = 0.25  # greatest remaining fraction of the misfit
_HALF = 0.5  # likewise, if the rest can be the machine's own error
_OWN = 2.0  # times the usual error of a machine: up to here it can be that of this machine, at the worse rows
_AS_WELL = 4.0  # times the rest of the best explanation, if that leaves too much: up to here, simpler ones win
_EQUAL = 1.001  # times: the same mistake in other words
_ALIKE = 1.5  # times the rest of another: not distinguishable from it
_OTHERS = 2  # named after the first
_MUCH = 4.0  # factor by which a single column must explain it better than all together, and be worse itself
_FEWEST = 4  # poses: with fewer, nearly any mistake explains everything
_MOST = 300  # rows examined
_MOST_ROWS = 0.75
_CAN_BE_TAKEN = 0.9  # least fraction of the commands that can be reached


@dataclass(frozen=True)
class _Cause:
    """A mistake that explains why measurements do not fit."""

    text: str  #: the mistake and its remedy, or several that cannot be distinguished
    before: float  #: tip error of the machine as described, 75th percentile over the rows [m]
    after: float  #: the same without the mistake [m]

    def __str__(self) -> str:
        return f"{self.text}; that explains all but {1e3 * self.after:.3g} mm of {1e3 * self.before:.3g} mm"


def likely_cause(
    measurements: Measurements, robot: Robot, eta: float = TIP_LENGTH, *, least: float = 0.0, alike: float = 0.0
) -> _Cause | None:
    """Find the mistake that best explains why measurements do not fit a robot; None if no usual one does.

    A tip error of `least` [m] needs no mistake to explain it; mistakes that leave less than `alike` [m] explain equally
    well. eta weighs the orientation [m/rad].

    Raises:
        PM3DofError: the commands are out of reach, or no base can be found.
    """
    measurements = measurements[:_MOST]
    own_frame = measurements.registration is not None
    measurements, nominal = _at_nominal(measurements, robot)
    before = _misfit(measurements, nominal, eta, own_frame)
    if before <= least or len(measurements.visits) < _FEWEST:
        return None
    # a scale and a free frame can explain anything by one point in the middle of the machine's poses
    middle = nominal[np.full(len(nominal), len(nominal) // 2)]
    most = min(
        before, float(np.median(tip_error(pose_difference(middle.transforms, nominal.transforms), eta))) or before
    )

    def explanation(mistakes: Iterable[Mistake]) -> _Cause | None:
        found = []
        for mistake in mistakes:
            try:
                without, poses = mistake.without, mistake.nominal
                if poses is None:
                    near = near_their_ranges(without.commands, robot)
                    _require_most(near)
                    without, poses = _at_nominal(without[near], robot)
                after = _misfit(without, poses, eta, own_frame or mistake.free)
            except PM3DofError:
                continue
            if after < _EXPLAINS * most or after < min(_OWN * least, _HALF * before):
                found.append(_Cause(mistake.text, before, after))
        best = min((cause.after for cause in found), default=0.0)
        return next((cause for cause in found if cause.after <= _EQUAL * best), None)

    def simplest(kinds: Iterable[Iterable[Mistake]], enough: float = 0.0) -> _Cause | None:
        causes = [cause for kind in kinds if (cause := explanation(kind)) is not None]
        best = min((cause.after for cause in causes), default=0.0)
        as_well = max(enough, (_ALIKE if best <= enough else _AS_WELL) * best)
        first = next((cause for cause in causes if cause.after <= as_well), None)
        if first is None:
            return None
        as_good = _ALIKE * (first.after if first.after <= _AS_WELL * best else best)
        others = [cause.text for cause in causes if cause is not first and cause.after <= as_good]
        return replace(first, text=", or ".join([first.text, *others[:_OTHERS]]))

    whole = simplest(usual_mistakes(measurements, nominal, eta), alike)
    if whole is not None and whole.after <= _OWN * least:
        return whole
    # positions or orientations as a whole say little if the machine itself could be as far off
    kinds = itertools.islice(wrong_columns(measurements, nominal, eta), None if before > _MUCH * least else 1)
    column = simplest(kinds, least)
    return column if whole is None or (column is not None and column.after < whole.after / _MUCH) else whole


def change_in_the_middle(measurements: Measurements, poses: Poses, eta: float = TIP_LENGTH) -> str:
    """Say from which line on the measurements are of another set-up, given a machine's poses; "" if none.

    A machine identified from all of them lies between the two set-ups.
    """
    datum = datum_motions(poses)

    def misfit(found: Measurements) -> float:
        common = datum @ explained_by(found, poses, eta, datum)
        left = seen_errors(found.without_motions(poses, common), poses[first], eta).errors
        return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))

    first = measurements.first_rows
    before = misfit(measurements)
    found = min(
        (_Cause(mistake.text, before, misfit(mistake.without)) for mistake in of_a_change(measurements, poses, eta)),
        key=lambda cause: cause.after,
        default=None,
    )
    return str(found) if found is not None and found.after < _HALF * before else ""


def _at_nominal(measurements: Measurements, robot: Robot) -> tuple[Measurements, Poses]:
    """Return the rows whose commands the robot as described can reach, and its poses there.

    Raises:
        InvalidValueError: too few such rows.
    """
    nominal = robot.forward(measurements.commands, on_failure="nan")
    _require_most(nominal.solved)
    return measurements[nominal.solved], nominal[nominal.solved]


def _require_most(taken: Mask) -> None:
    if np.mean(taken) < _CAN_BE_TAKEN:
        raise InvalidValueError("commands", problem="are out of reach")


def _misfit(measurements: Measurements, nominal: Poses, eta: float, own_frame: bool) -> float:
    """Return the tip error of the machine as described against the measurements, 75th percentile over the rows [m].

    Not the median: a mistake may affect less than half of the rows.
    """
    if own_frame:
        measurements = measurements.in_axes(measurements.registered_at(nominal, eta))
    return float(np.quantile(measurements.tip_misfits(nominal, eta), _MOST_ROWS))
