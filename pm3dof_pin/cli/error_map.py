"""`pm3dof error-map`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.options import Json, load_tripod
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.cli.progress import progress_bar

if TYPE_CHECKING:
    from collections.abc import Callable

    from pm3dof_pin.errors.error_map import ErrorMap, ParameterShare
    from pm3dof_pin.errors.error_parameters import GeometricErrors

PICTURES = {
    "error_map_tip.png": "tip_rms",
    "error_map_uncompensable.png": "uncompensable_rms",
    "error_map_worst.png": "worst_tip",
}
SHOWN = 10

RobotName = Annotated[
    str, typer.Option("--robot", metavar="NAME|URDF", help="A robot by name, or the path of its URDF.")
]


def error_map(
    robot: RobotName = "pm3dof",
    out: Annotated[Path, typer.Option(help="Folder to write to; made if it is not there.")] = Path("results"),
    height: Annotated[
        float | None, typer.Option(help="Height z_e of the section [m]; by default that of Table 8.3.")
    ] = None,
    tilt: Annotated[float, typer.Option(help="Tilts run from minus to plus this angle [deg].")] = 40.0,
    points: Annotated[int, typer.Option(min=2, help="Number of values of each tilt.")] = 41,
    samples: Annotated[int, typer.Option(min=1, help="Number of random poses of any other robot.")] = 300,
    eta: Annotated[
        float, typer.Option(min=0.0, help="Weight of the orientation in the tip error [m/rad]: the length of the tool.")
    ] = 0.1,
    uniform: Annotated[
        bool, typer.Option("--uniform", help="Tolerances are half widths of uniform distributions, not sigmas.")
    ] = False,
    target: Annotated[
        float | None, typer.Option(help="Allocate tolerances so that the tip error stays within this [m] everywhere.")
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw the pictures.")] = True,
    as_json: Json = False,
) -> None:
    """Errors of the tool that errors of the parts lead to, over the workspace: an error map, and the critical parts.

    Parts and their tolerances stand in the robot's error file, `<robot>.errors.yaml` beside its URDF; a robot without
    one has 0.1 mm and 0.5 mrad at every joint. The tripod is mapped over a section of its workspace, any other robot is
    judged at random poses.
    """
    from pm3dof_pin.errors.error_parameters import GeometricErrors
    from pm3dof_pin.maps.error_section import MOTION_COORDINATES

    errors = GeometricErrors.load(robot)
    result: dict[str, Any] = {"robot": errors.mechanism.name, "eta_m_per_rad": eta}
    with progress_bar("error map") as progress:
        if errors.mechanism.motion_coordinates == MOTION_COORDINATES and robot == "pm3dof":
            mapped, files, z_e = _section(errors, out, height, tilt, points, eta, uniform, pictures, progress)
            result["z_e_m"] = z_e
        else:
            mapped, files = _sampled(errors, samples, eta, uniform), []
        ranking = mapped.ranking()
        files.append(_write_ranking(ranking, out / "error_ranking.csv"))
        if pictures:
            from pm3dof_pin.figures.error_ranking import error_ranking
            from pm3dof_pin.figures.style import save_figure

            files.append(save_figure(error_ranking(ranking), out / "error_ranking.png"))
        result |= _summary(mapped) | {"ranking": [_plain(share) for share in ranking]}
        if target is not None:
            result["allocation"] = _allocation(mapped, target)
    print_result(result | {"files": [str(file) for file in files]}, _lines(result), as_json=as_json)
    for file in files:
        message(f"wrote {file}")


def _section(
    errors: GeometricErrors,
    out: Path,
    height: float | None,
    tilt: float,
    points: int,
    eta: float,
    uniform: bool,
    pictures: bool,
    progress: Callable[[int, int], None],
) -> tuple[ErrorMap, list[Path], float]:
    from pm3dof_pin.maps.error_section import error_outline, error_section
    from pm3dof_pin.maps.grid import RectangularGrid
    from pm3dof_pin.maps.storage import write_csv, write_netcdf

    tripod, angle = load_tripod(None), math.radians(tilt)
    grid = RectangularGrid(theta_x_range=(-angle, angle), theta_y_range=(-angle, angle), shape=(points, points))
    steps = 2 + len(PICTURES) * pictures
    distribution = "uniform" if uniform else "normal"
    section, mapped = error_section(tripod, errors, grid, height, eta=eta, distribution=distribution)  # type: ignore[arg-type]
    progress(1, steps)
    files = [write_netcdf(section, out / "error_map.nc"), write_csv(section, out / "error_map.csv")]
    if pictures:
        from pm3dof_pin.figures.section_map import section_map
        from pm3dof_pin.figures.style import save_figure

        outline = error_outline(tripod, errors, grid, section)
        for name, variable in PICTURES.items():
            files.append(save_figure(section_map(section, variable, outline), out / name))
            progress(len(files), steps)
    return mapped, files, float(section["z_e"])


def _sampled(errors: GeometricErrors, samples: int, eta: float, uniform: bool) -> ErrorMap:
    import numpy as np

    from pm3dof_pin.cli.closing_errors import closing_errors
    from pm3dof_pin.errors.error_map import error_map as compute
    from pm3dof_pin.kinematics.reachable_poses import reachable_poses

    poses = reachable_poses(errors.mechanism, samples, np.random.default_rng(0))
    return compute(closing_errors(errors, poses), poses, eta=eta, distribution="uniform" if uniform else "normal")


def _summary(mapped: ErrorMap) -> dict[str, Any]:
    quantities = {
        "tip_rms_m": mapped.tip_rms,
        "compensable_rms_m": mapped.compensable_rms,
        "uncompensable_rms_m": mapped.uncompensable_rms,
        "position_rms_m": mapped.position_rms,
        "orientation_rms_rad": mapped.orientation_rms,
        "worst_tip_m": mapped.worst_tip,
    }
    return {
        "poses": len(mapped.poses),
        "parameters": len(mapped.errors),
        "least": {name: float(values.min()) for name, values in quantities.items()},
        "mean": {name: float(values.mean()) for name, values in quantities.items()},
        "greatest": {name: float(values.max()) for name, values in quantities.items()},
    }


def _allocation(mapped: ErrorMap, target: float) -> dict[str, Any]:
    from pm3dof_pin.errors.tolerances import equal_contributions, least_cost

    return {
        "target_m": target,
        "equal_contributions": equal_contributions(mapped, target).tolerances,
        "least_cost": least_cost(mapped, target).tolerances,
        "least_cost_with_corrected_commands": least_cost(mapped, target, compensated=True).tolerances,
    }


def _plain(share: ParameterShare) -> dict[str, Any]:
    return {"tip_rms_m" if name == "tip_rms" else name: value for name, value in share.__dict__.items()}


def _write_ranking(ranking: list[ParameterShare], path: Path) -> Path:
    from pm3dof_pin.files import write_text_atomically

    rows = [
        f"{share.name},{share.group},{share.tip_rms:.9g},{share.share:.9g},{share.uncompensable_share:.9g}"
        for share in ranking
    ]
    return write_text_atomically(path, "\n".join(["parameter,class,tip_rms_m,share,uncompensable_share", *rows]) + "\n")


def _lines(result: dict[str, Any]) -> list[str]:
    words = {
        "tip_rms_m": "tip error, rms",
        "compensable_rms_m": "- that commands can undo",
        "uncompensable_rms_m": "- that no command can undo",
        "position_rms_m": "position error, rms",
        "orientation_rms_rad": "orientation error, rms",
        "worst_tip_m": "tip error, bound",
    }
    rows = [
        [text, *(f"{1e6 * result[kind][name]:.1f}" for kind in ("least", "mean", "greatest"))]
        for name, text in words.items()
    ]
    where = f"the section z_e = {result['z_e_m']:.6f} m" if "z_e_m" in result else "the workspace, at random"
    critical = [
        [
            share["name"],
            share["group"],
            f"{1e6 * share['tip_rms_m']:.1f}",
            f"{share['share']:.1%}",
            f"{share['uncompensable_share']:.1%}",
        ]
        for share in result["ranking"][:SHOWN]
    ]
    lines = [
        f"{result['robot']}: {result['parameters']} error parameters, {result['poses']:,} poses of {where}, "
        f"eta = {result['eta_m_per_rad']:g} m/rad",
        *table_lines(["[µm, µrad]", "least", "mean", "greatest"], rows),
        "",
        *table_lines(["critical parameters", "class", "tip [µm]", "of all", "of what stays"], critical),
    ]
    if "allocation" in result:
        lines += ["", *_allocation_lines(result["allocation"])]
    return lines


def _allocation_lines(allocation: dict[str, Any]) -> list[str]:
    kinds = ("equal_contributions", "least_cost", "least_cost_with_corrected_commands")
    rows = [
        [
            name,
            *("any" if math.isinf(allocation[kind][name]) else f"{1e6 * allocation[kind][name]:.1f}" for kind in kinds),
        ]
        for name in allocation[kinds[0]]
    ]
    header = [f"for {1e6 * allocation['target_m']:g} µm [µm, µrad]", "equal parts", "least cost", "commands corrected"]
    return table_lines(header, rows)
