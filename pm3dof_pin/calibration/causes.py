"""Why measurements do not fit a machine: the usual mistakes, tried one after the other.

Each is a change of the measurements (:mod:`pm3dof_pin.calibration.mistakes`). The machine as described, which is at
most tolerances away from the real one, is compared with what was measured before and after the change; the base of the
instrument is found anew where that was asked for. A mistake that explains most of what does not fit is likely the one
that was made, and of several that explain as much the simplest. Others that cannot be told from it are named beside it:
where the platform never turns, another tool point is another frame.
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

_EXPLAINS = 0.25  # of what did not fit is left, at most
_HALF = 0.5  # likewise, if that is no more than what needs no mistake
_AS_WELL = 4.0  # times what the best explanation leaves: one of a simpler kind is taken
_EQUAL = 1.001  # times: the same in other words
_ALIKE = 1.5  # times what another leaves: not to be told from it
_OTHERS = 2  # named beside the first
_MUCH = 4.0  # times better a single column has to explain it than what concerns all, and worse it has to be
_FEWEST = 4  # poses: with fewer nearly any mistake explains all
_MOST = 300  # rows examined
_MOST_ROWS = 0.75
_CAN_BE_TAKEN = 0.9  # of the commands, at least


@dataclass(frozen=True)
class _Cause:
    """A mistake that explains why measurements do not fit."""

    text: str  #: the mistake, and what to do about it, or several that cannot be told apart
    before: float  #: tip error of the machine as described, which three in four rows keep to [m]
    after: float  #: the same without the mistake [m]

    def __str__(self) -> str:
        return f"{self.text}; that explains all but {1e3 * self.after:.3g} mm of {1e3 * self.before:.3g} mm"


def likely_cause(
    measurements: Measurements, robot: Robot, eta: float = TIP_LENGTH, *, least: float = 0.0, alike: float = 0.0
) -> _Cause | None:
    """Find the mistake that explains best why measurements do not fit a robot; None if none of the usual ones does.

    A tip error of `least` [m] needs no mistake to explain it, and mistakes that leave less than `alike` [m] explain as
    much as each other. eta weighs the orientation [m/rad].

    Raises:
        PM3DofError: the commands cannot be taken, or no base can be found.
    """
    measurements = measurements[:_MOST]
    own_frame = measurements.registration is not None
    measurements, nominal = _at_nominal(measurements, robot)
    before = _misfit(measurements, nominal, eta, own_frame)
    if before <= least or len(measurements.visits) < _FEWEST:
        return None
    # one scale more and a free frame explain anything that is nowhere by a point in the middle of the machine's poses
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
            if after < _EXPLAINS * most or after < min(least, _HALF * before):
                found.append(_Cause(mistake.text, before, after))
        best = min((cause.after for cause in found), default=0.0)
        return next((cause for cause in found if cause.after <= _EQUAL * best), None)

    def simplest(kinds: Iterable[Iterable[Mistake]], enough: float = 0.0) -> _Cause | None:
        causes = [cause for kind in kinds if (cause := explanation(kind)) is not None]
        best = min((cause.after for cause in causes), default=0.0)
        first = next((cause for cause in causes if cause.after <= max(_AS_WELL * best, enough)), None)
        if first is None:
            return None
        as_good = _ALIKE * (first.after if first.after <= _AS_WELL * best else best)
        others = [cause.text for cause in causes if cause is not first and cause.after <= as_good]
        return replace(first, text=", or ".join([first.text, *others[:_OTHERS]]))

    whole = simplest(usual_mistakes(measurements, nominal, eta), alike)
    if whole is not None and whole.after <= least:
        return whole
    # all positions, or all orientations, say little where the machine itself could be as far off
    kinds = itertools.islice(wrong_columns(measurements, nominal, eta), None if before > _MUCH * least else 1)
    column = simplest(kinds, least)
    return column if whole is None or (column is not None and column.after < whole.after / _MUCH) else whole


def change_in_the_middle(measurements: Measurements, poses: Poses, eta: float = TIP_LENGTH) -> str:
    """Say from where on measurements are those of another set-up, by a machine's poses; "" if nothing tells so.

    A machine that was identified from all of them stands between the two.
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
    """Return the rows whose commands the robot as described can take, and its poses there.

    Raises:
        InvalidValueError: these are too few.
    """
    nominal = robot.forward(measurements.commands, on_failure="nan")
    _require_most(nominal.solved)
    return measurements[nominal.solved], nominal[nominal.solved]


def _require_most(taken: Mask) -> None:
    if np.mean(taken) < _CAN_BE_TAKEN:
        raise InvalidValueError("commands", "out of reach", "commands that the machine can take")


def _misfit(measurements: Measurements, nominal: Poses, eta: float, own_frame: bool) -> float:
    """Return the tip error of the machine as described against the measurements: what three in four rows keep to [m].

    Not the median, as a mistake may be in less than half of the rows.
    """
    if own_frame:
        measurements = measurements.in_axes(measurements.registered_at(nominal, eta))
    return float(np.quantile(measurements.tip_misfits(nominal, eta), _MOST_ROWS))
