"""`pm3dof workspace`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.options import Config, Json, load_tripod
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.cli.progress import progress_bar

if TYPE_CHECKING:
    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.workspace import Workspace


def workspace(
    out: Annotated[Path, typer.Option(help="Folder to write to; made if it is not there.")] = Path("results"),
    heights: Annotated[int, typer.Option(min=3, help="Number of sections.")] = 121,
    directions: Annotated[int, typer.Option(min=8, help="Number of boundary points a section.")] = 360,
    picture: Annotated[bool, typer.Option(help="Draw the picture of Fig. 8.2.")] = True,
    as_json: Json = False,
    config: Config = None,
) -> None:
    """The reachable set under all joint limits: boundary, areas, volume, which limit binds where (Fig. 8.2)."""
    from pm3dof_pin.maps.boundary import workspace_boundary
    from pm3dof_pin.maps.storage import write_csv, write_netcdf
    from pm3dof_pin.workspace import workspace as reachable_set

    tripod = load_tripod(config)
    with progress_bar("workspace") as progress:
        space = reachable_set(tripod, heights, directions)
        progress(1, 4 if picture else 3)
        boundary = workspace_boundary(tripod, space)
        files = [write_netcdf(boundary, out / "workspace.nc"), write_csv(boundary, out / "workspace.csv")]
        progress(3, 4 if picture else 3)
        if picture:
            from pm3dof_pin.figures.style import save_figure
            from pm3dof_pin.figures.workspace import workspace_figure

            files.append(save_figure(workspace_figure(tripod, space), out / "figure_8_2_workspace.png"))
    result = _result(tripod, space) | {"files": [str(file) for file in files]}
    print_result(result, _lines(result), as_json=as_json)
    for file in files:
        message(f"wrote {file}")


def _result(tripod: Tripod, space: Workspace) -> dict[str, Any]:
    from pm3dof_pin.chapter.printed_ranges import compare_printed_ranges

    tilts = dict(zip(("theta_x", "theta_y"), space.tilt_ranges, strict=True))
    return {
        "volume_rad2_m": space.volume,
        "z_e_range_m": space.height_range,
        **{f"{name}_range_rad": bounds for name, bounds in tilts.items()},
        "limit_shares": {(limit.name or "").lower(): share for limit, share in space.limit_shares.items()},
        "sections": [{"z_e_m": section.z_e, "area_rad2": section.area} for section in space.sections],
        "printed_ranges": [statement.text for statement in compare_printed_ranges(tripod, space)],
    }


def _lines(result: dict[str, Any]) -> list[str]:
    import numpy as np

    shown = result["sections"][:: max(1, len(result["sections"]) // 10)]
    rows = [
        [
            f"{section['z_e_m']:.4f}",
            f"{section['area_rad2']:.4f}",
            f"{np.degrees(np.degrees(section['area_rad2'])):.1f}",
        ]
        for section in shown
    ]
    tilts = {name: np.degrees(result[f"{name}_range_rad"]) for name in ("theta_x", "theta_y")}
    ranges = [f"{name} {least:.2f} .. {greatest:.2f} deg" for name, (least, greatest) in tilts.items()]
    low, high = result["z_e_range_m"]
    shares = ", ".join(f"{name} {share:.1%}" for name, share in result["limit_shares"].items())
    return [
        *table_lines(["z_e [m]", "area [rad^2]", "area [deg^2]"], rows),
        "",
        f"volume {result['volume_rad2_m']:.6f} rad^2 m, z_e {low:.4f} .. {high:.4f} m, {', '.join(ranges)}",
        f"limits along the boundary: {shares}",
        "",
        "beside the chapter's working ranges:",
        *(f"- {text}" for text in result["printed_ranges"]),
    ]
