"""The chapter's numbers as map quantities, for robots described by the parameters of a tripod."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pm3dof_pin.chapter.chapter_stiffness import AXES, chapter_stiffness, global_index
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantities import Dimension, Evaluation, MappedRobot, quantity
from pm3dof_pin.typing import Array

COORDINATES = ("theta_x", "theta_y", "z_e")


def _tripod_of(robot: Robot) -> Tripod | None:
    """Return the tripod of the parameter file `config/<name>.yaml` in the robot's description, or None."""
    if tuple(coordinate.name for coordinate in robot.coordinates) != COORDINATES:
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


@quantity(
    "chapter_diagonal",
    dims=(Dimension("chapter_axis", lambda mapped: AXES),),
    unit="N m/rad (theta_x, theta_y, theta_z), N/m (t_z, t_x, t_y)",
    long_name="stiffness as the chapter computes it",
    exists=_is_tripod,
)
def _chapter_diagonal(evaluation: Evaluation) -> Array:
    tripod = _tripod_of(evaluation.mapped.robot)
    assert tripod is not None
    return chapter_stiffness(tripod, evaluation.poses.coordinates, on_failure="nan")


quantity("chapter_global", unit="mixed", long_name="mean of the chapter's six numbers", exists=_is_tripod)(
    lambda evaluation: global_index(_chapter_diagonal(evaluation))
)
quantity(
    "slider_travel",
    dims=(Dimension("leg", lambda mapped: tuple(str(leg + 1) for leg in range(len(mapped.robot.commands)))),),
    unit="m",
    long_name="slider travel along the guideways",
    exists=_is_tripod,
)(lambda evaluation: evaluation.poses.commands)
