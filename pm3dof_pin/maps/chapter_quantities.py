"""The chapter's numbers as map quantities, for robots described by the parameters of a tripod."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pm3dof_pin.chapter.chapter_stiffness import AXES, chapter_stiffness, global_index
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantity import Dimension, Evaluation, MappedRobot, Quantity
from pm3dof_pin.typing import Array

_COORDINATES = ("theta_x", "theta_y", "z_e")


def _tripod_of(robot: Robot) -> Tripod | None:
    """Return the tripod of the parameter file `config/<name>.yaml` in the robot's description, or None."""
    if tuple(coordinate.name for coordinate in robot.coordinates) != _COORDINATES:
        return None
    return _tripod(Path(robot.source).absolute().parent.parent / "config" / f"{robot.name}.yaml")


@lru_cache(maxsize=8)
def _tripod(config: Path) -> Tripod | None:
    try:
        return Tripod.load(config)
    except PM3DofError:
        return None


def _is_tripod(mapped: MappedRobot) -> bool:
    """Tell whether the robot is a tripod of the chapter's family."""
    return _tripod_of(mapped.robot) is not None


def _chapter_diagonal(evaluation: Evaluation) -> Array:
    tripod = _tripod_of(evaluation.mapped.robot)
    assert tripod is not None  # it exists
    return chapter_stiffness(tripod, evaluation.poses.coordinates, on_failure="nan")


CHAPTER_QUANTITIES = (
    Quantity(
        "chapter_diagonal",
        _chapter_diagonal,
        "N m/rad (theta_x, theta_y, theta_z), N/m (t_z, t_x, t_y)",
        "stiffness as the chapter computes it",
        (Dimension("chapter_axis", lambda mapped: AXES),),
        _is_tripod,
    ),
    Quantity(
        "chapter_global",
        lambda evaluation: global_index(_chapter_diagonal(evaluation)),
        "mixed",
        "mean of the chapter's six numbers",
        exists=_is_tripod,
    ),
    Quantity(
        "slider_travel",
        lambda evaluation: evaluation.poses.commands,
        "m",
        "slider travel along the guideways",
        (Dimension("leg", lambda mapped: tuple(str(leg + 1) for leg in range(len(mapped.robot.commands)))),),
        _is_tripod,
    ),
)
"""The chapter's numbers, for tripods of its family."""
