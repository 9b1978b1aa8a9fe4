"""`pm3dof stiffness-map`, the main job."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pm3dof_pin.cli.options import Config, Json, finite_number, load_tripod, tilt_angle
from pm3dof_pin.cli.output import message, print_result
from pm3dof_pin.cli.progress import progress_bar
from pm3dof_pin.cli.table import rows_as_data, rows_as_lines

if TYPE_CHECKING:
    from pm3dof_pin.chapter.tripod import Tripod

LEAST_TO_DRAW = 3
PICTURES = {
    "figure_8_3a_theta_x.png": "stiffness_theta_x",
    "figure_8_3b_theta_y.png": "stiffness_theta_y",
    "figure_8_3c_t_z.png": "stiffness_t_z",
    "figure_8_4_global.png": "stiffness_global",
}


def stiffness_map(
    out: Annotated[Path, typer.Option(help="Folder to write to; made if it is not there.")] = Path("results"),
    height: Annotated[
        float | None,
        typer.Option(parser=finite_number, help="Height z_e of the section [m]; by default that of Table 8.3."),
    ] = None,
    tilt: Annotated[
        float, typer.Option(parser=tilt_angle, help="Tilts run from minus to plus this angle [deg].")
    ] = 40.0,
    points: Annotated[int, typer.Option(min=2, help="Number of values of each tilt.")] = 81,
    pictures: Annotated[bool, typer.Option(help="Draw the pictures of Figs. 8.3 and 8.4.")] = True,
    as_json: Json = False,
    config: Config = None,
) -> None:
    """Maps of the chapter's stiffness as dataset, spreadsheet and pictures (Figs. 8.3, 8.4), and Table 8.3."""
    from pm3dof_pin.chapter.table_8_3 import table_8_3
    from pm3dof_pin.maps.grid import RectangularGrid
    from pm3dof_pin.maps.section import stiffness_section
    from pm3dof_pin.maps.storage import write_csv, write_netcdf

    tripod = load_tripod(config)
    angle = math.radians(tilt)
    grid = RectangularGrid(theta_x_range=(-angle, angle), theta_y_range=(-angle, angle), shape=(points, points))
    names = list(PICTURES) if pictures else []
    with progress_bar("stiffness map") as progress:
        section = stiffness_section(tripod, grid, height)
        inside = int((section["broken_limits"] == 0).sum())
        z_e = float(section["z_e"])
        _require_poses(tripod, z_e, inside, drawn=pictures)
        files = [write_netcdf(section, out / "stiffness_map.nc"), write_csv(section, out / "stiffness_map.csv")]
        progress(2, 2 + len(names))
        if names:
            from pm3dof_pin.figures.section_map import section_map
            from pm3dof_pin.figures.style import save_figure
            from pm3dof_pin.maps.section import section_outline

            outline = section_outline(tripod, grid, height)
            for name in names:
                files.append(save_figure(section_map(section, PICTURES[name], outline), out / name))
                progress(len(files), 2 + len(names))
    rows = table_8_3(tripod)
    result = {"files": [str(file) for file in files], "z_e_m": z_e, "poses": points**2, "poses_within_limits": inside}
    lines = [] if height is None else [f"Table 8.3, at its own height of {tripod.middle_height:.6f} m", ""]
    lines += [
        *rows_as_lines(rows),
        "",
        f"{points**2:,} poses at z_e = {z_e:.6f} m, {inside:,} within every joint limit",
    ]
    print_result(result | {"rows": rows_as_data(rows)}, lines, as_json=as_json)
    for file in files:
        message(f"wrote {file}")


def _require_poses(tripod: Tripod, z_e: float, inside: int, *, drawn: bool) -> None:
    """Refuse a map without anything on it, or with too little for its pictures, before a file is written."""
    from pm3dof_pin.exceptions import UnreachablePoseError

    where = f"of the map at z_e = {z_e:g} m"
    if inside == 0:
        level = f"{tripod.height_min:.4f} to {tripod.height_max:.4f} m"
        raise UnreachablePoseError(f"no pose {where} is within every joint limit; the level platform goes from {level}")
    if drawn and inside < LEAST_TO_DRAW:
        raise UnreachablePoseError(
            f"{inside} of the poses {where} within every joint limit, too few to draw: "
            "more --points, a smaller --tilt, or --no-pictures"
        )
