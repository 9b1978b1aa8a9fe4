"""`pm3dof atlas`."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Literal

import typer

from pm3dof_pin.cli.map_options import (
    CoordinateRange,
    EngineOption,
    Quantities,
    Ranges,
    Threads,
    Values,
    declared_ranges,
    known_quantities,
    robot_grid,
)
from pm3dof_pin.cli.options import AppliedWrenches, Json, MachineOptions, tilt_angle
from pm3dof_pin.cli.output import message, print_result, progress_bar
from pm3dof_pin.cli.pictures import Formats, PictureFormat, remove_former, save
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.atlas import Atlas, compute_atlas, open_atlas
from pm3dof_pin.maps.quantity import NO_WRENCH, MappedRobot
from pm3dof_pin.typing import Branch

_MIN_POINTS = 2
_POSES = 10_000  # approximate size of an atlas over all coordinates
_TILTS = ("theta_x", "theta_y", "z_e")
_DEFAULT_POINTS = (91, 91, 61)
_DEFAULT_TILT = 45.0
_DEFAULT_QUANTITIES = ("felt_stiffness", "condition_number", "chapter_global")


def atlas(
    which: MachineOptions,
    quantity: Quantities = None,
    out: Annotated[Path, typer.Option(help="Output: NetCDF (.nc) or Zarr (.zarr).")] = Path("results/atlas.nc"),
    ranges: Ranges = None,
    values: Values = None,
    counts: Annotated[
        str | None,
        typer.Option(metavar="N,N,..", help="Number of values for each coordinate, or one number for all."),
    ] = None,
    points: Annotated[
        tuple[int, int, int] | None,
        typer.Option(metavar="NX NY NZ", help="Number of values of theta_x, theta_y and z_e (91 91 61)."),
    ] = None,
    tilt: Annotated[
        float | None,
        typer.Option(parser=tilt_angle, help="Range of theta_x and theta_y, plus or minus [deg] (45)."),
    ] = None,
    heights: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="FIRST LAST", help="Range of z_e [m]; by default the heights of the level platform."),
    ] = None,
    all_branches: Annotated[
        bool,
        typer.Option("--all-branches", help="What geometry alone allows, with quantity branch, not only home's."),
    ] = False,
    keep_beyond_limits: Annotated[
        bool, typer.Option("--keep-beyond-limits", help="Keep values at poses that break a joint limit.")
    ] = False,
    precision: Annotated[Literal["single", "double"], typer.Option(help="Precision of numbers on disk.")] = "single",
    pictures: Annotated[bool, typer.Option(help="Draw slices of every quantity that is not a matrix.")] = True,
    formats: Formats = None,
    wrench: AppliedWrenches = None,
    threads: Threads = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on the dask cluster of this scheduler.")
    ] = None,
    engine: EngineOption = "program",
    list_quantities: Annotated[bool, typer.Option("--list", help="List the quantities and exit.")] = False,
    as_json: Json = False,
) -> None:
    """Map quantities over a robot's workspace as labelled arrays: angles in degrees, lengths in metres.

    The axes are the coordinates named with --range, in that order. Without --range they are all coordinates over their
    ranges; for pm3dof, z_e, theta_x, theta_y. An interrupted job resumes when the same command is run again.
    """
    known = known_quantities(quantity)
    if out.suffix not in (".nc", ".zarr"):
        raise typer.BadParameter(f"--out {out}: expected a name ending in .nc or .zarr")
    if points and min(points) < _MIN_POINTS:
        raise typer.BadParameter(f"--points {' '.join(map(str, points))}: expected at least {_MIN_POINTS} each")
    if heights and not (all(map(math.isfinite, heights)) and heights[0] < heights[1]):
        raise typer.BadParameter(f"--heights {heights[0]:g} {heights[1]:g}: expected two finite, increasing heights")
    loaded = which.load(engine)
    existing = {name: entry for name, entry in known.items() if entry.exists(MappedRobot(loaded))}
    if list_quantities:
        mapped = MappedRobot(loaded)
        listed = {name: {"unit": entry.unit_for(mapped), "what": entry.long_name} for name, entry in existing.items()}
        lines = [f"{name}: {entry['what']} [{entry['unit']}]" for name, entry in listed.items()]
        print_result({"robot": loaded.name, "quantities": listed}, lines, as_json=as_json)
        return
    names = tuple(quantity or (name for name in _DEFAULT_QUANTITIES if name in existing))
    if all_branches and "branch" in existing:
        names = tuple(dict.fromkeys((*names, "branch")))
    if ranges or counts:
        if points or tilt is not None or heights:
            raise typer.BadParameter("--points, --tilt and --heights cannot be combined with --range or --counts")
        grid = robot_grid(loaded, ranges or _all_ranges(loaded, counts), values or ())
    elif tuple(coordinate.name for coordinate in loaded.coordinates) == _TILTS:
        grid = robot_grid(
            loaded, _tilt_ranges(loaded, points or _DEFAULT_POINTS, _DEFAULT_TILT if tilt is None else tilt, heights)
        )
    elif points or tilt is not None or heights:
        raise typer.BadParameter(f"--points, --tilt and --heights are for robots with {', '.join(_TILTS)}: use --range")
    else:
        grid = robot_grid(loaded, _all_ranges(loaded, None))
    branches: Branch = "all" if all_branches else "home"
    job = Atlas(
        loaded, grid, names, out, keep_beyond_limits, precision, branches, tuple(map(tuple, wrench or NO_WRENCH))
    )
    resumed = job.parts.exists()
    try:
        with progress_bar("poses") as progress:

            def show(done: int, total: int) -> None:
                nonlocal resumed
                if resumed:  # only now is it known that the job can resume
                    message(f"resuming from {job.parts}")
                resumed = False
                progress(done, total)

            path = compute_atlas(job, threads=threads, scheduler=scheduler, progress=show)
    except KeyboardInterrupt:
        message(f"interrupted: finished blocks are kept in {job.parts}; run the same command again to resume")
        raise
    files = [path, *_draw(path, loaded, formats)] if pictures else [path]
    remove_former(path.parent, rf"{re.escape(path.stem)}_(?:{'|'.join(known)})(?:_.+)?", files)
    result = {
        "robot": loaded.name,
        "dimensions": grid.dims,
        "poses": grid.size,
        "quantities": job.quantities,
    }
    print_result(result, [f"{grid.size:,} poses: {', '.join(job.quantities)}"], as_json=as_json, files=files)


def _tilt_ranges(
    robot: Robot, points: tuple[int, int, int], tilt: float, heights: tuple[float, float] | None
) -> list[CoordinateRange]:
    """Return --points, --tilt and --heights as values of --range: z_e, theta_x, theta_y."""
    nx, ny, nz = points
    low, high = heights or robot.range_of(robot.coordinate("z_e"))
    tilts = [CoordinateRange(name, -tilt, tilt, count) for name, count in (("theta_x", nx), ("theta_y", ny))]
    return [CoordinateRange("z_e", low, high, nz), *tilts]


def _all_ranges(robot: Robot, counts: str | None) -> list[CoordinateRange]:
    """Return the ranges of all coordinates, with the counts of --counts."""
    dimensions = len(robot.coordinates)
    try:
        numbers = [int(word) for word in counts.replace(",", " ").split()] if counts else []
    except ValueError:
        raise typer.BadParameter(f"--counts {counts}: expected whole numbers") from None
    if counts and (len(numbers) not in (1, dimensions) or min(numbers) < _MIN_POINTS):
        raise typer.BadParameter(
            f"--counts {counts}: expected one number, or {dimensions} for {robot.name}, of at least {_MIN_POINTS}"
        )
    if not numbers:
        numbers = [max(_MIN_POINTS, round(_POSES ** (1.0 / max(dimensions, 1))))]
    return declared_ranges(robot, robot.coordinates, numbers if len(numbers) == dimensions else numbers * dimensions)


def _draw(path: Path, robot: Robot, formats: list[PictureFormat] | None) -> list[Path]:
    """Draw the pictures of a finished atlas next to it."""
    from pm3dof_pin.figures.atlas import atlas_pictures

    with progress_bar("pictures") as progress:
        with open_atlas(path) as dataset:
            figures = atlas_pictures(dataset, robot)
        files = []
        for done, (name, figure) in enumerate(figures.items(), start=1):
            files += save(figure, path.with_name(f"{path.stem}_{name}.png"), formats)
            progress(done, len(figures))
    return files
