"""`pm3dof stiffness`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
import typer

from pm3dof_pin.chapter import chapter_stiffness as chapter
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.cli.options import THE_TRIPOD, Json, MachineOptions, PoseOptions, numbers_by_name
from pm3dof_pin.cli.output import fixed, message, print_result, stop_on_broken_limits, table_lines
from pm3dof_pin.cli.poses import column_of, place, print_at_pose, si_values, solve_chosen
from pm3dof_pin.cli.singularity_report import read_singularity_distances, singularity_line
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.elastic import indices
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.free_motions import FreeMotionStiffness, free_motion_stiffness
from pm3dof_pin.elastic.indices import axis_stiffness
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.preload import preload
from pm3dof_pin.elastic.report import CartesianCompliance, cartesian_compliance, direction_names
from pm3dof_pin.elastic.shares import shares
from pm3dof_pin.elastic.springs import STUBBY, CantileverSpring
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array, Matrix, Vector

_JSON_UNITS = {
    "K": "N/m, N, N m/rad",
    "C": "m/N, 1/N, rad/(N m)",
    "felt": "N/m (x, y, z), N m/rad (rx, ry, rz)",
    "eigenvalues": "N/m, at the characteristic length",
    "principal": "N/m (translation), N m/rad (rotation)",
    "spring_shares": "1",
    "free_motion_stiffness": "N/m, N, N m/rad",
}
UNITS = ("N/m", "N/m", "N/m", "N m/rad", "N m/rad", "N m/rad")


Model: TypeAlias = Literal["elastic", "chapter"]
"""Stiffness models."""


def stiffness(
    chosen: PoseOptions,
    which: MachineOptions,
    model: Annotated[
        Model,
        typer.Option(help="elastic: the 6 x 6 stiffness at the tool; chapter: the diagonal of section 8.2.3 (pm3dof)."),
    ] = "elastic",
    preloaded: Annotated[
        list[str] | None,
        typer.Option(
            "--preload",
            metavar="JOINT=FORCE,..",
            help="Forces of some drives [N, N m]; redundant others balance them with the least.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute the stiffness of the tool at a pose: angles in degrees, lengths in metres.

    If the tool is rigid in some direction there is no 6 x 6 stiffness: the compliance is printed, and the stiffness of
    the tool's free motions. With --preload redundant drives work against each other, which changes the stiffness. A
    pose that breaks a joint limit is still computed, with a message and exit status 1.
    """
    machine = which.load()
    forces = numbers_by_name("--preload", preloaded)
    if forces is not None and (model == "chapter" or chosen.poses is not None or not isinstance(forces, dict)):
        raise typer.BadParameter("--preload requires JOINT=FORCE, the elastic model and a single pose")
    if model == "chapter":
        if not which.is_the_tripod or not chosen.numbers:
            raise typer.BadParameter(f"--model chapter requires a pose of the machine of chapter 8, {THE_TRIPOD}")
        _print_chapter(which.tripod(), si_values(machine, machine.coordinates, chosen.numbers), as_json)
        stop_on_broken_limits(broken_limits(machine, place(machine, chosen).configuration()))
        return
    elastic = ElasticModel(machine)
    pose = solve_chosen(machine, chosen, lambda poses: _columns(elastic, poses), as_json)
    if pose is None:
        return
    configuration = pose.configuration()
    tool = cartesian_compliance(elastic, configuration)
    _name_stubby_beams(elastic, configuration)
    loaded = None
    if isinstance(forces, dict):
        loads = preload(elastic, configuration, forces)
        loaded = loaded_equilibrium(elastic, configuration, loads)
        result = _read(elastic, loaded.tangent_compliance(), (), np.zeros((0, 6, 6)))
        result |= {"preload": loads.efforts, "least_eigenvalue": loaded.least_eigenvalue}
    else:
        result = _read(elastic, tool.compliance, tool.spring_names, tool.contributions)
    if tool.rigid_directions.size:  # K does not exist, C does
        result |= {"K": None, "rigid_directions": tool.rigid_directions.T}
        free = _free_motions(elastic, tool, configuration)
        if free is not None and loaded is not None:
            rates = np.linalg.pinv(free.twists)
            free = replace(free, stiffness=np.linalg.inv(rates @ loaded.tangent_compliance() @ rates.T))
        result |= {} if free is None else _read_free_motions(free)
    elif loaded is not None:
        result |= _read_stiffness(loaded.tangent_stiffness(), loaded.tangent_compliance())
    else:
        result |= _read_stiffness(tool.stiffness, tool.compliance)
    result["singularity_distances"] = read_singularity_distances(configuration)
    units = {key: unit for key, unit in _JSON_UNITS.items() if key in result or key in result.get("indices", {})}
    print_at_pose(pose, result | {"units": units}, _elastic_lines(result), as_json=as_json)


def _name_stubby_beams(elastic: ElasticModel, configuration: Configuration) -> None:
    """Print a message about beams that are rigid in shear and so short here that it would matter."""
    where = elastic.configuration(configuration)
    for spring, block in zip(elastic.springs, elastic.blocks, strict=True):
        if not isinstance(spring, CantileverSpring) or spring.shear_stiffness is not None:
            continue
        length = spring.length if isinstance(spring.length, float) else elastic.length(block, where)
        if (share := spring.shear_share(length)) >= STUBBY:
            message(
                f"pm3dof: '{spring.name}' is {1e3 * length:.3g} mm long here and rigid in shear as described; shear "
                f"would add {100.0 * share:z.0f} % to its lateral give (shear_stiffness)"
            )


def _free_motions(
    elastic: ElasticModel, tool: CartesianCompliance, configuration: Configuration
) -> FreeMotionStiffness | None:
    """Return the stiffness of the free motions; None, with a message, if it does not exist either."""
    message(f"pm3dof: the tool is rigid, so there is no 6 x 6 K. Rigid: {direction_names(tool.rigid_directions)}")
    try:
        return free_motion_stiffness(elastic, configuration)
    except SingularConfigurationError as error:
        message(f"pm3dof: nor is there a K of the free motions: {error}")
        return None


def _read_free_motions(free: FreeMotionStiffness) -> dict[str, Any]:
    return {
        "free_motions": [{"name": name, "unit": unit} for name, unit in zip(free.names, free.units, strict=True)],
        "free_motion_twists": free.twists.T,
        "free_motion_stiffness": free.stiffness,
    }


def _columns(elastic: ElasticModel, poses: Poses) -> dict[str, Array]:
    """Return the felt stiffness and the compliance of many poses as columns."""
    matrices = compliance(elastic, poses, on_failure="nan")
    felt = axis_stiffness(np.einsum("nii->ni", matrices), elastic.mechanism.length_unit)
    columns = {column_of(f"felt_{axis}", UNITS[k]): felt[:, k] for k, axis in enumerate(TOOL_COMPONENTS)}
    for row, column in itertools.combinations_with_replacement(range(6), 2):
        unit = ("m/N", "1/N", "rad/(N m)")[(row >= 3) + (column >= 3)]
        columns[column_of(f"C_{TOOL_COMPONENTS[row]}_{TOOL_COMPONENTS[column]}", unit)] = matrices[:, row, column]
    return columns


def _print_chapter(tripod: Tripod, pose: Vector, as_json: bool) -> None:
    diagonal = chapter.chapter_stiffness(tripod, pose)
    index = float(chapter.global_index(diagonal))
    named = dict(zip(chapter.AXES, diagonal, strict=True))
    rows = [[axis, f"{value:.6e}", chapter.UNITS[axis]] for axis, value in named.items()]
    rows.append(["global", f"{index:.6e}", "mean of the six"])
    result = {"robot": THE_TRIPOD, "model": "chapter", "diagonal": named, "global": index, "units": chapter.UNITS}
    print_result(result, table_lines(["axis", "stiffness", "unit"], rows), as_json=as_json)


def _read(elastic: ElasticModel, compliance: Matrix, names: Sequence[str], contributions: Array) -> dict[str, Any]:
    """Return the results from a compliance; a rigid axis has infinite felt stiffness and no shares."""
    felt = axis_stiffness(np.diag(compliance), elastic.mechanism.length_unit)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = shares(contributions[None], np.eye(6))  # a unit force or moment along each axis in turn
    parts[np.isinf(felt)] = np.nan
    return {
        "model": "elastic",
        "C": compliance,
        "felt": dict(zip(TOOL_COMPONENTS, felt, strict=True)),
        "spring_shares": {
            axis: dict(zip(names, row, strict=True)) for axis, row in zip(TOOL_COMPONENTS, parts, strict=True)
        },
    }


def _read_stiffness(stiffness: Matrix, compliance: Matrix) -> dict[str, Any]:
    """Return the results from a stiffness and its inverse, the compliance."""
    length = indices.characteristic_length(stiffness)
    principal = {
        f"{motion}_others_{others}": indices.principal_axes(
            indices.condensed_stiffness(compliance, motion, others)
        ).values
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
    """Return the results from one stiffness, or one compliance, as text lines."""
    name, units = ("C", "m/N, 1/N, rad/(N m)") if result["K"] is None else ("K", "N/m, N, N m/rad")
    matrix = _rows(TOOL_COMPONENTS, result[name])
    felt = [
        [axis, f"{value:.4e}", unit, *(_percent(share) for share in result["spring_shares"][axis].values())]
        for (axis, value), unit in zip(result["felt"].items(), UNITS, strict=True)
    ]
    lines = [
        f"{name} at the tool, axes of the base, order x, y, z, rx, ry, rz [{units}]",
        *table_lines(["", *TOOL_COMPONENTS], matrix),
        "",
        "felt stiffness 1 / C_jj, as a probe measures it"
        + ("" if "preload" in result else ", and the share of each spring in the deflection"),
        *table_lines(["axis", "felt", "unit", *result["spring_shares"]["x"]], felt),
    ]
    if "preload" in result:
        forces = ", ".join(f"{name} {force:.6g}" for name, force in result["preload"].items())
        eigenvalue = f"least eigenvalue {result['least_eigenvalue']:z.4f} (unstable below 0)"
        lines += ["", f"preload [N, N m]: {forces}; {eigenvalue}"]
    if result["K"] is not None:
        lines += ["", *_index_lines(result["indices"])]
    elif "free_motions" in result:
        lines += ["", *_free_motion_lines(result)]
    return lines + singularity_line(result["singularity_distances"])


def _free_motion_lines(result: dict[str, Any]) -> list[str]:
    names = [f"{motion['name']} [{motion['unit']}]" for motion in result["free_motions"]]
    rows = _rows(names, result["free_motion_stiffness"])
    return ["stiffness K of the free motions [N/m, N, N m/rad]", *table_lines(["", *names], rows)]


def _rows(names: Sequence[str], matrix: Sequence[Sequence[float]]) -> list[list[str]]:
    """Format a symmetric matrix, with 0 for rounding errors relative to its diagonal."""
    size = [math.sqrt(abs(row[k])) for k, row in enumerate(matrix)]
    return [
        [name, *("0" if abs(entry) < 1e-12 * size[i] * size[j] else f"{entry:.4e}" for j, entry in enumerate(row))]
        for i, (name, row) in enumerate(zip(names, matrix, strict=True))
    ]


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
        f"{indices['characteristic_length_m']:z.4f} m; trace / 6 = {indices['trace_over_six']:.4e}",
    ]
