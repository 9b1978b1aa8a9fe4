"""`pm3dof atlas`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.cli.options import Config, Json, load_tripod, tilt_angle
from pm3dof_pin.cli.output import message, print_result
from pm3dof_pin.cli.progress import progress_bar

LEAST_POINTS = 2

Quantities = Annotated[
    list[str] | None,
    typer.Option("--quantity", "-q", help="What to map; may be given several times. --list names them all."),
]


def atlas(
    quantity: Quantities = None,
    out: Annotated[Path, typer.Option(help="Result: NetCDF (.nc) or Zarr (.zarr).")] = Path("results/atlas.nc"),
    points: Annotated[
        tuple[int, int, int], typer.Option(metavar="NX NY NZ", help="Number of theta_x, theta_y and z_e.")
    ] = (91, 91, 61),
    tilt: Annotated[
        float, typer.Option(parser=tilt_angle, help="Tilts run from minus to plus this angle [deg].")
    ] = 45.0,
    heights: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="FIRST LAST", help="Heights z_e [m]; those of the level platform by default."),
    ] = None,
    keep_beyond_limits: Annotated[
        bool, typer.Option("--keep-beyond-limits", help="Keep values of poses that break a joint limit.")
    ] = False,
    pictures: Annotated[bool, typer.Option(help="Draw slices through every quantity but matrices.")] = True,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; the number of processors by default.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on the dask cluster of this scheduler.")
    ] = None,
    list_quantities: Annotated[bool, typer.Option("--list", help="List the quantities and leave.")] = False,
    as_json: Json = False,
    config: Config = None,
) -> None:
    """Quantities over the whole workspace (theta_x, theta_y, z_e) as labelled arrays: angles in degrees, metres.

    A job that was interrupted goes on where it stopped when the same command is given again.
    """
    from pm3dof_pin.maps.atlas import DEFAULT_QUANTITIES, Atlas, AtlasGrid, compute_atlas
    from pm3dof_pin.maps.grid import RectangularGrid
    from pm3dof_pin.maps.quantities import QUANTITIES

    if list_quantities:
        known = {name: {"unit": entry.unit, "what": entry.long_name} for name, entry in QUANTITIES.items()}
        lines = [f"{name}: {entry['what']} [{entry['unit']}]" for name, entry in known.items()]
        print_result({"quantities": known}, lines, as_json=as_json)
        return
    names = tuple(quantity or DEFAULT_QUANTITIES)
    for name in names:
        if name not in QUANTITIES:
            raise typer.BadParameter(f"no quantity '{name}', expected one of {', '.join(QUANTITIES)}")
    if out.suffix not in (".nc", ".zarr"):
        raise typer.BadParameter(f"--out {out}: expected a name ending in .nc or .zarr")
    if min(points) < LEAST_POINTS:
        raise typer.BadParameter(f"--points {' '.join(map(str, points))}: expected at least {LEAST_POINTS} each")
    if heights and not (all(map(math.isfinite, heights)) and heights[0] < heights[1]):
        raise typer.BadParameter(f"--heights {heights[0]:g} {heights[1]:g}: expected two growing finite heights")
    tripod = load_tripod(config)
    angle = math.radians(tilt)
    grid = AtlasGrid(
        RectangularGrid(theta_x_range=(-angle, angle), theta_y_range=(-angle, angle), shape=points[:2]),
        heights or (tripod.height_min, tripod.height_max),
        points[2],
    )
    job = Atlas(tripod, grid, names, out, keep_beyond_limits)
    if job.parts.exists():
        message(f"going on with {job.parts}")
    try:
        with progress_bar("poses") as progress:
            path = compute_atlas(job, workers=workers, scheduler=scheduler, progress=progress)
    except KeyboardInterrupt:
        message(f"interrupted: finished blocks are kept in {job.parts}, and the same command goes on there")
        raise
    files = [path, *_draw(path)] if pictures else [path]
    poses = math.prod(grid.shape)
    result = {"files": [str(file) for file in files], "poses": poses, "quantities": job.quantities}
    print_result(result, [f"{poses:,} poses: {', '.join(job.quantities)}"], as_json=as_json)
    for file in files:
        message(f"wrote {file}")


def _draw(path: Path) -> list[Path]:
    """Draw the pictures of a finished atlas beside it."""
    from pm3dof_pin.figures.atlas import atlas_pictures
    from pm3dof_pin.figures.style import save_figure
    from pm3dof_pin.maps.atlas import open_atlas

    with open_atlas(path) as dataset:
        figures = atlas_pictures(dataset)
    files = []
    with progress_bar("pictures") as progress:
        for name, figure in figures.items():
            files.append(save_figure(figure, path.with_name(f"{path.stem}_{name}.png")))
            progress(len(files), len(figures))
    return files
