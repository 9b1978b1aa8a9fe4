"""`pm3dof stiffness-map`, the main job."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.map_options import EngineOption, Over, Values, declared_ranges, robot_grid
from pm3dof_pin.cli.options import THE_TRIPOD, Json, MachineOrChapterOptions, Out, finite_number, tilt_angle
from pm3dof_pin.cli.output import print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import Formats, PictureFormat, remove_former, save
from pm3dof_pin.cli.table import described

if TYPE_CHECKING:
    from collections.abc import Callable

    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.figures.outlined_mesh import OutlinedMesh
    from pm3dof_pin.kinematics.grid import Grid
    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.maps.datasets import Map
    from pm3dof_pin.typing import Array, Engine

_MIN_TO_DRAW = 3
_MOST_PICTURES = 10  # beyond, of principal stiffnesses only the least are drawn
PICTURES = {
    "figure_8_3a_theta_x.png": "stiffness_theta_x",
    "figure_8_3b_theta_y.png": "stiffness_theta_y",
    "figure_8_3c_t_z.png": "stiffness_t_z",
    "figure_8_4_global.png": "stiffness_global",
}
_DEFAULT_TILT, _DEFAULT_POINTS = 40.0, 81
_DEFAULT_COUNT = 41
_STATISTICS = {"least": "minimum", "greatest": "maximum", "mean": "mean"}
JOB_PICTURES = rf"stiffness_map_.+|{'|'.join(name.removesuffix('.png') for name in PICTURES)}"
"""Regular expression of all pictures that the job may draw."""


def stiffness_map(
    which: MachineOrChapterOptions,
    out: Out = Path("results"),
    over: Over = None,
    values: Values = None,
    height: Annotated[
        float | None,
        typer.Option(parser=finite_number, help="Height z_e of the chapter's section [m] (as in Table 8.3)."),
    ] = None,
    tilt: Annotated[
        float | None,
        typer.Option(parser=tilt_angle, help="Greatest tilt of the chapter's section [deg] (40)."),
    ] = None,
    points: Annotated[
        int | None, typer.Option(min=2, help="Number of values of each tilt (81), or of each coordinate (41).")
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw the pictures.")] = True,
    formats: Formats = None,
    engine: EngineOption = "program",
    as_json: Json = False,
) -> None:
    """Map the stiffness to a dataset, a spreadsheet and pictures: angles in degrees, lengths in metres.

    Without --robot, the maps are the chapter's (Figs. 8.3, 8.4), with Table 8.3 if the section is the same; in closed
    form, or by --engine pinocchio. With --robot (pm3dof too), they show felt and principal stiffness, condition number
    and first natural frequency over two coordinates; if the tool is rigid in some direction, the stiffness of its free
    motions. Of principal stiffnesses only the least have pictures. Pictures of an earlier run are replaced.
    """
    if which.robot is None and not over and not values and which.tool_frame is None:
        _map_of_chapter(which, out, height, tilt, points or _DEFAULT_POINTS, pictures, formats, as_json, engine)
        return
    if height is not None or tilt is not None:
        raise typer.BadParameter("--height and --tilt are for the chapter's map: use --over and --at instead")
    loaded = which.load(engine)
    from pm3dof_pin.maps.quantity import MappedRobot

    if over and len(over) != 2:
        raise typer.BadParameter(f"expected --over twice, not {len(over)} times")
    named = {entry.name for entry in values or ()}
    free = [coordinate for coordinate in loaded.coordinates if coordinate.name not in named][:2]
    grid = robot_grid(
        loaded, over or declared_ranges(loaded, free, [points or _DEFAULT_COUNT] * len(free)), values or ()
    )
    if len(grid.axes) < 2:
        raise typer.BadParameter(f"{loaded.name} has fewer than two coordinates to map over")
    mapped = MappedRobot(loaded)
    with progress_bar("stiffness map") as progress:
        from pm3dof_pin.maps.datasets import write_map
        from pm3dof_pin.maps.grid_map import quantities_over, quantity_arrays
        from pm3dof_pin.maps.workspace_evaluation import stiffness_quantities

        quantities = (*stiffness_quantities(mapped), "first_frequency")
        dataset = quantity_arrays(mapped, grid, quantities)
        inside = int((dataset.data_vars["broken_limits"].values == 0).sum())
        _require_poses(f"over {' and '.join(grid.dims)} of {loaded.name}", inside, drawn=pictures)
        files = write_map(dataset, out / "stiffness_map")
        if pictures:
            exact = quantities_over(mapped, grid, quantities)
            files += _draw(dataset, loaded, grid, exact, out, progress, formats)
        remove_former(out, JOB_PICTURES, files)
    spans = _ranges(dataset)
    result = {
        "robot": loaded.name,
        "dimensions": grid.dims,
        "fixed": dict(grid.fixed),
        "poses": grid.size,
        "poses_within_limits": inside,
        "ranges": spans,
    }
    lines = [
        *_range_lines(spans),
        "",
        f"{grid.size:,} poses over {' and '.join(grid.dims)}, {inside:,} within every limit",
    ]
    print_result(result, lines, as_json=as_json, files=files)


def _ranges(dataset: Map) -> dict[str, dict[str, Any]]:
    """Return the least, greatest and mean finite value of every entry of the map."""
    import numpy as np

    from pm3dof_pin.maps.datasets import unit_of_entry

    ranges = {}
    for name, label, index in _entries(dataset):
        values = dataset.data_vars[name].values[index]
        finite = values[np.isfinite(values)]
        if finite.size:
            ranges[f"{name}_{label}" if label else name] = {
                "least": float(finite.min()),
                "greatest": float(finite.max()),
                "mean": float(finite.mean()),
                "unit": unit_of_entry(dataset.variables[name].attrs["units"], label),
            }
    return ranges


def _range_lines(ranges: dict[str, dict[str, Any]]) -> list[str]:
    """Return the ranges of a map as table lines."""
    rows = [
        [name, "" if entry["unit"] == "1" else entry["unit"], *(f"{entry[key]:.4e}" for key in _STATISTICS)]
        for name, entry in ranges.items()
    ]
    return table_lines(["quantity", "unit", *_STATISTICS.values()], rows, words=2)


def _entries(dataset: Map) -> list[tuple[str, str, Any]]:
    """Return every entry of the map as variable, label and index; of matrices, the diagonal."""
    entries: list[tuple[str, str, Any]] = []
    for name, variable in dataset.data_vars.items():
        own = variable.dims[2:]
        labels: Any = dataset.variables[own[0]].values if own else [""]
        indices: list[Any] = [(..., *[k] * len(own)) for k in range(len(labels))]
        if "flag_masks" not in variable.attrs:
            entries += [(str(name), str(labels[k]), index) for k, index in enumerate(indices)]
    return entries


def _draw(
    dataset: Map,
    robot: Robot,
    grid: Grid,
    exact: Callable[[Array], dict[str, Array]],
    out: Path,
    progress: Any,
    formats: list[PictureFormat] | None,
) -> list[Path]:
    """Draw a picture of every entry of the map that has finite values, or of the ten that say most."""
    import numpy as np

    from pm3dof_pin.figures.section_map import section_map
    from pm3dof_pin.maps.limit_space import limits_over

    broken = limits_over(robot, grid.dims, grid.fixed)
    meshes: dict[bytes, OutlinedMesh] = {}
    entries = _entries(dataset)
    if len(entries) > _MOST_PICTURES:
        entries = [entry for entry in entries if entry[1] not in ("middle", "greatest")]
    files = []
    for done, (name, label, index) in enumerate(entries, start=1):
        if np.isfinite(dataset.data_vars[name].values[index]).sum() >= _MIN_TO_DRAW:
            path = out / f"stiffness_map_{f'{name}_{label}' if label else name}.png"
            figure = section_map(
                dataset,
                name,
                entry=label or None,
                within=lambda points: broken(points) == 0,
                meshes=meshes,
                exact=lambda points, name=name, index=index: exact(points)[name][index],  # type: ignore[misc]
            )
            files += save(figure, path, formats)
        progress(done, len(entries))
    return files


def _map_of_chapter(
    which: MachineOrChapterOptions,
    out: Path,
    height: float | None,
    tilt: float | None,
    points: int,
    pictures: bool,
    formats: list[PictureFormat] | None,
    as_json: bool,
    engine: Engine,
) -> None:
    from pm3dof_pin.chapter.table_8_3 import table_8_3
    from pm3dof_pin.chapter.tilt_grids import RectangularGrid
    from pm3dof_pin.maps.chapter_section import section_values, stiffness_section
    from pm3dof_pin.maps.datasets import write_map

    tripod, machine = which.tripod(), which.load() if engine == "pinocchio" else None
    angle = math.radians(_DEFAULT_TILT if tilt is None else tilt)
    grid = RectangularGrid(theta_x_range=(-angle, angle), theta_y_range=(-angle, angle), shape=(points, points))
    names = list(PICTURES) if pictures else []
    with progress_bar("stiffness map") as progress:
        section = stiffness_section(tripod, grid, height, robot=machine)
        inside = int((section.data_vars["broken_limits"].values == 0).sum())
        z_e = float(section.coords["z_e"].values)
        _require_poses(f"at z_e = {z_e:g} m", inside, drawn=pictures, tripod=tripod)
        files = write_map(section, out / "stiffness_map")
        progress(2, 2 + len(names))
        if names:
            from pm3dof_pin.figures.section_map import section_map
            from pm3dof_pin.maps.chapter_workspace import tripod_space

            within = partial(tripod_space(tripod).within, level=z_e)
            for done, name in enumerate(names, start=3):
                exact = None if machine else section_values(tripod, z_e, PICTURES[name])
                files += save(section_map(section, PICTURES[name], within=within, exact=exact), out / name, formats)
                progress(done, 2 + len(names))
        remove_former(out, JOB_PICTURES, files)
    (table, table_of_8_3), statistics = described(table_8_3(tripod, robot=machine)), _ranges(section)
    result = {
        "robot": THE_TRIPOD,
        "z_e_m": z_e,
        "poses": points**2,
        "poses_within_limits": inside,
        "ranges": statistics,
    }
    lines = [
        "Stiffness of the chapter's machine over its poses within every limit:",
        *_range_lines(statistics),
        "",
        f"{points**2:,} poses at z_e = {z_e:z.6f} m, {inside:,} within every joint limit",
    ]
    if height is None and tilt is None and which.config is None:
        lines += ["", "Table 8.3 of the chapter, over its own poses:", *table_of_8_3]
    print_result(result | table, lines, as_json=as_json, files=files)


def _require_poses(place: str, inside: int, *, drawn: bool, tripod: Tripod | None = None) -> None:
    """Reject a map with no poses, or with too few for pictures, before any file is written."""
    from pm3dof_pin.exceptions import UnreachablePoseError

    if inside == 0:
        hint = "try other ranges, or --at"
        if tripod is not None:
            hint = f"--height: the level platform reaches from {tripod.height_min:z.4f} to {tripod.height_max:z.4f} m"
        raise UnreachablePoseError(f"no pose of the map {place} is within every joint limit; {hint}")
    if drawn and inside < _MIN_TO_DRAW:
        raise UnreachablePoseError(
            f"{inside} poses of the map {place} are within every joint limit, too few to draw: "
            "try more --points, other ranges, or --no-pictures"
        )
