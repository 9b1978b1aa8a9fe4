"""`pm3dof stiffness`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.options import (
    Config,
    Json,
    NamedConfiguration,
    OptionalHeight,
    OptionalThetaX,
    OptionalThetaY,
    RobotName,
    Target,
    load_tripod,
    pose_of,
)
from pm3dof_pin.cli.output import fixed, message, print_result, stop_on_broken_limits, table_lines

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pm3dof_pin.chapter.tripod import Tripod

AXES = ("x", "y", "z", "rx", "ry", "rz")
_RIGID = 1e-12  # an axis that gives less than this times the softest of its kind gives nothing
JSON_UNITS = {
    "K": "N/m, N, N m/rad",
    "C": "m/N, 1/N, rad/(N m)",
    "felt": "N/m (x, y, z), N m/rad (rx, ry, rz)",
    "eigenvalues": "N/m, at the characteristic length",
    "principal": "N/m (translation), N m/rad (rotation)",
    "spring_shares": "1",
}
UNITS = ("N/m", "N/m", "N/m", "N m/rad", "N m/rad", "N m/rad")


class Model(StrEnum):
    """Stiffness models."""

    ELASTIC = "elastic"
    CHAPTER = "chapter"


def stiffness(
    theta_x: OptionalThetaX = None,
    theta_y: OptionalThetaY = None,
    z_e: OptionalHeight = None,
    model: Annotated[
        Model, typer.Option(help="elastic: the 6 x 6 stiffness at the tool; chapter: the diagonal of section 8.2.3.")
    ] = Model.ELASTIC,
    robot: RobotName = None,
    configuration: NamedConfiguration = None,
    as_json: Json = False,
    config: Config = None,
) -> None:
    """Stiffness at a pose of the platform: angles in degrees, height in metres; or at a configuration of any robot.

    A pose that breaks a joint limit is still answered, with a message and exit status 1.
    """
    target = Target.of(theta_x, theta_y, z_e, robot, configuration)
    if target.pose is None:
        if model is Model.CHAPTER or config is not None:
            raise typer.BadParameter("--model chapter and --config are for the tripod at a pose TX TY Z")
        _print_of_robot(target, as_json)
        return
    from pm3dof_pin.chapter.limits import limit_violations

    tripod = load_tripod(config)
    pose = pose_of(*target.pose)
    (_print_chapter if model is Model.CHAPTER else _print_elastic)(tripod, pose, as_json)
    stop_on_broken_limits(limit_violations(tripod, pose))


def _print_of_robot(target: Target, as_json: bool) -> None:
    """Print the stiffness of any robot's tool by condensation over its loop closures."""
    from pm3dof_pin.elastic import ElasticModel, cartesian_compliance
    from pm3dof_pin.elastic.directions import direction_names

    elastic = ElasticModel.load(target.robot)
    where = target.configuration(elastic.rigid)
    tool = cartesian_compliance(elastic, where)
    result = _read(tool.compliance, tool.spring_names, tool.contributions)
    if tool.rigid_directions.size:  # K does not exist, C does
        result |= {"K": None, "rigid_directions": tool.rigid_directions.T}
        directions = direction_names(tool.rigid_directions)
        message(f"pm3dof: the tool is rigid, so there is no K; this is C. Rigid are: {directions}")
    else:
        result |= _read_stiffness(tool.stiffness, tool.compliance)
    print_result(result | {"units": JSON_UNITS}, _elastic_lines(result), as_json=as_json)
    stop_on_broken_limits(target.broken_limits(where))


def _print_chapter(tripod: Tripod, pose: NDArray[np.float64], as_json: bool) -> None:
    from pm3dof_pin.chapter import chapter_stiffness as chapter

    diagonal = chapter.chapter_stiffness(tripod, pose)
    index = float(chapter.global_index(diagonal))
    named = dict(zip(chapter.AXES, diagonal, strict=True))
    rows = [[axis, f"{value:.6e}", chapter.UNITS[axis]] for axis, value in named.items()]
    rows.append(["global", f"{index:.6e}", "mean of the six"])
    result = {"model": "chapter", "diagonal": named, "global": index, "units": chapter.UNITS}
    print_result(result, table_lines(["axis", "stiffness", "unit"], rows), as_json=as_json)


def _print_elastic(tripod: Tripod, pose: NDArray[np.float64], as_json: bool) -> None:
    from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness, spring_contributions, spring_names
    from pm3dof_pin.elastic.indices import compliance

    matrix = elastic_stiffness(tripod, pose)
    tool = compliance(matrix)
    result = _read(tool, spring_names(tripod), spring_contributions(tripod, pose)) | _read_stiffness(matrix, tool)
    print_result(result | {"units": JSON_UNITS}, _elastic_lines(result), as_json=as_json)


def _read(compliance: NDArray[np.float64], names: Sequence[str], contributions: NDArray[np.float64]) -> dict[str, Any]:
    """Return what is read from a compliance; an axis that is rigid feels infinitely stiff and has no shares."""
    import numpy as np

    from pm3dof_pin.elastic.shares import shares

    diagonal = np.diag(compliance)
    rigid = diagonal <= _RIGID * np.repeat(diagonal.reshape(2, 3).max(axis=1), 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        felt = np.where(rigid, np.inf, 1.0 / diagonal)
        parts = shares(contributions[None], np.eye(6))  # a unit force or moment along each axis in turn
    parts[rigid] = np.nan
    return {
        "model": "elastic",
        "C": compliance,
        "felt": dict(zip(AXES, felt, strict=True)),
        "spring_shares": {axis: dict(zip(names, row, strict=True)) for axis, row in zip(AXES, parts, strict=True)},
    }


def _read_stiffness(stiffness: NDArray[np.float64], compliance: NDArray[np.float64]) -> dict[str, Any]:
    """Return what is read from a stiffness and the compliance that is its inverse."""
    import numpy as np

    from pm3dof_pin.elastic import indices

    length = indices.characteristic_length(stiffness)
    principal = {
        f"{motion}_others_{others}": indices.ellipsoid(indices.condensed_stiffness(compliance, motion, others)).values
        for motion in ("translation", "rotation")
        for others in ("free", "held")
    }
    return {
        "K": stiffness,
        "eigenvalues": indices.eigenvalues(stiffness, length),
        "indices": {
            "characteristic_length_m": float(length),
            "condition_number": float(indices.condition_number(stiffness, length)),
            "principal": principal,
            "trace_over_six": float(np.trace(stiffness)) / 6.0,
        },
    }


def _elastic_lines(result: dict[str, Any]) -> list[str]:
    """Return what is read from one stiffness, or from one compliance, as lines for a person."""
    name, units = ("C", "m/N, 1/N, rad/(N m)") if result["K"] is None else ("K", "N/m, N, N m/rad")
    matrix = [[axis, *(f"{entry:.4e}" for entry in row)] for axis, row in zip(AXES, result[name], strict=True)]
    felt = [
        [axis, f"{value:.4e}", unit, *(_percent(share) for share in result["spring_shares"][axis].values())]
        for (axis, value), unit in zip(result["felt"].items(), UNITS, strict=True)
    ]
    lines = [
        f"{name} at the tool, axes of the base, order x, y, z, rx, ry, rz [{units}]",
        *table_lines(["", *AXES], matrix),
        "",
        "stiffness that a probe feels, 1 / C_jj, and the part of each spring in the deflection",
        *table_lines(["axis", "felt", "unit", *result["spring_shares"]["x"]], felt),
    ]
    return lines if result["K"] is None else [*lines, "", *_index_lines(result["indices"])]


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{fixed(100.0 * share, 1)}%"


def _index_lines(indices: dict[str, Any]) -> list[str]:
    principal = [
        [name.replace("_", " "), *(f"{value:.4e}" for value in values)] for name, values in indices["principal"].items()
    ]
    return [
        "principal stiffnesses [N/m, N m/rad], the other three motions free or held",
        *table_lines(["", "least", "middle", "greatest"], principal),
        "",
        f"condition number {indices['condition_number']:.3e} at the characteristic length "
        f"{indices['characteristic_length_m']:.4f} m; trace / 6 = {indices['trace_over_six']:.4e}",
    ]
