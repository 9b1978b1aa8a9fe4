"""`pm3dof view`."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
import typer

from pm3dof_pin.cli import completion
from pm3dof_pin.cli.drive_options import NUMBER_OF_DRIVES, limits_of_drives
from pm3dof_pin.cli.options import MachineOptions, PlaceOptions
from pm3dof_pin.cli.output import message, stop_on_broken_limits
from pm3dof_pin.cli.poses import place, solve_pose
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent, unit_of
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.indices import OtherMotions
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import (
    DescriptionError,
    InvalidValueError,
    PM3DofError,
    RigidDirectionError,
    SingularConfigurationError,
    UnreachablePoseError,
)
from pm3dof_pin.kinematics.actuation import motion_components
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.pose_file import read_poses
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array, Matrix, Motion
from pm3dof_pin.viewer import Viewer
from pm3dof_pin.viewer.ellipsoids import EllipsoidMatrix, MotionQuantity
from pm3dof_pin.viewer.lacks import lacks_of
from pm3dof_pin.viewer.polytopes import PolytopeQuantity
from pm3dof_pin.viewer.server import is_loopback

_FRAMES_PER_SECOND = 20
_LOAD = 100.0  # whose deflection is shown first [N, N m]
_KINDS: tuple[Motion, Motion] = ("translation", "rotation")
_DEFLECTIONS = ("deflection_x_m", "deflection_y_m", "deflection_z_m")  # of files of `pm3dof path`
_FOR_EVER = 10_000  # repetitions of a path


EllipsoidKind: TypeAlias = Literal["stiffness", "compliance", "velocity", "force", "error"]
_ELASTIC: dict[EllipsoidKind, EllipsoidMatrix] = {"stiffness": "stiffness", "compliance": "compliance"}
_OF_MOTION: dict[EllipsoidKind, MotionQuantity] = {"velocity": "velocity", "force": "force", "error": "error"}


LimitOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar=NUMBER_OF_DRIVES, help="Show what drives of these limits can exert, or how fast they can move."
    ),
]


def view(
    chosen: PlaceOptions,
    which: MachineOptions,
    of: Annotated[EllipsoidKind, typer.Option(help="What the ellipsoids show.")] = "stiffness",
    others: Annotated[
        Literal["free", "held"] | None,
        typer.Option(help="The other three motions: free or held; by default held for stiffness, free for compliance."),
    ] = None,
    forces: Annotated[
        bool, typer.Option(help="Show the actuator forces that hold the weight as arrows; not along a path.")
    ] = True,
    effort: LimitOption = None,
    speed: LimitOption = None,
    frames: Annotated[bool, typer.Option(help="Show the frames of the tool and the loop closures.")] = False,
    labels: Annotated[
        bool, typer.Option("--labels", help="Label the points; for the chapter's machine, also lengths and angles.")
    ] = False,
    shares: Annotated[
        ToolComponent | None,
        typer.Option(metavar="LOAD", help="Colour the legs by their share of the compliance in x, y, z, rx, ry or rz."),
    ] = None,
    workspace: Annotated[
        str | None,
        typer.Option(
            metavar="QUANTITY",
            autocompletion=completion.quantities,
            help="Show the workspace boundary, coloured by a quantity such as felt_stiffness:z.",
        ),
    ] = None,
    modes: Annotated[int, typer.Option(min=0, help="Number of natural modes in which the machine can swing.")] = 0,
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Play a path: a file as for --poses of ik, or one POSE per line."),
    ] = None,
    duration: Annotated[float, typer.Option(min=0.1, help="Duration of the path [s].")] = 6.0,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a self-contained page and exit.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a picture (PNG) and exit; needs Chromium or Chrome.")
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(
            "--film",
            metavar="FILE",
            help="Write a film (GIF or MP4) of the path, or once around the robot, and exit.",
        ),
    ] = None,
    size: Annotated[tuple[int, int], typer.Option(min=64, metavar="W H", help="Size of the picture [pixels].")] = (
        1200,
        900,
    ),
    host: Annotated[
        str, typer.Option(help="Interface to listen on; any but the loopback interface is open to the network.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port to listen on; by default the first free one from 7000.")
    ] = None,
    browser: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """Show the robot in a browser, with its stiffness ellipsoids at the tool: angles in degrees, lengths in metres.

    Sliders move it by its coordinates and by its commands. The page is served until Ctrl-C, to this machine only. A
    pose that breaks a joint limit is still shown, with a message (and exit status 1 if a file is written).
    """
    if path is not None and not chosen.is_empty:
        raise typer.BadParameter("--path cannot be combined with POSE or --configuration")
    machine = which.load()
    along, deflections = None, None
    if path is not None:
        along, deflections = _poses_on_path(machine, path, max(2, round(_FRAMES_PER_SECOND * duration) + 1))
    shown = place(machine, chosen).configuration() if along is None else along.configuration(0)
    broken = list(map(str, broken_limits(machine, shown))) if along is None else _limits_on_path(along)
    with Viewer(machine, host=host, port=port) as viewer:
        viewer.display(shown)
        model = _elastic_model(machine)
        if along is not None:
            compliance = None if model is None else _compliance_on_path(model, along)
            viewer.play(
                list(along),
                compliance=compliance,
                of=_ELASTIC.get(of, "stiffness"),
                others=others,
                deflections=deflections,
                duration=duration,
                repetitions=_FOR_EVER,
            )
        else:
            _draw_ellipsoids(viewer, model, of, others)
            _draw_polytopes(viewer, limits_of_drives(machine, effort=effort, speed=speed))
        if forces and along is None:
            _draw_forces(viewer, shown)
        if model is not None:
            _draw_load(viewer, model, shares, visible=workspace is None and along is None and not modes)
            if modes:
                viewer.modes(model, modes)
        if frames:
            viewer.frames()
        if labels:
            viewer.labels()
        if workspace is not None:
            _draw_workspace(viewer, workspace)
        if html is None and picture is None and film is None:
            _serve(viewer, broken, browser)
            return
        if html is not None:
            message(f"wrote {viewer.save_html(html)}")
        if picture is not None:
            message(f"wrote {viewer.save_picture(picture, width=size[0], height=size[1])}")
        if film is not None:
            message(f"wrote {viewer.record(film, width=size[0], height=size[1])}")
    stop_on_broken_limits(broken)


def _serve(viewer: Viewer, broken: Sequence[str], browser: bool) -> None:
    """Serve the page until Ctrl-C or SIGTERM."""
    logging.getLogger("pm3dof_pin.viewer.server").setLevel(logging.ERROR)  # its warning is repeated below
    for violation in broken:
        message(f"pm3dof: joint limit broken: {violation}")
    stop = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        stop.set()

    previous = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        url = viewer.start()
        message(f"{viewer.mechanism.name} at {url} until Ctrl-C")
        if not is_loopback(viewer.host):
            message(f"pm3dof: warning: listening on {viewer.host}: anyone who can reach this machine can see the page")
        if browser and not viewer.open():
            message("no browser could be opened: open the address yourself")
        stop.wait()
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        viewer.close()
    message("closed")


def _elastic_model(machine: Robot) -> ElasticModel | None:
    for lack in lacks_of(machine):
        message(f"pm3dof: {lack}")
    if not machine.springs or machine.tool_frame is None or machine.description.floating_base:
        return None
    return ElasticModel(machine)


def _draw_ellipsoids(
    viewer: Viewer, model: ElasticModel | None, of: EllipsoidKind, others: OtherMotions | None
) -> None:
    if viewer.mechanism.tool_frame is None or viewer.mechanism.description.floating_base:
        return
    try:
        for kind in _KINDS:
            if model is not None and of in _ELASTIC:
                compliance = cartesian_compliance(model, viewer.configuration).compliance
                viewer.stiffness_ellipsoid(compliance=compliance, kind=kind, of=_ELASTIC[of], others=others)
            else:
                viewer.motion_ellipsoid(_OF_MOTION.get(of, "velocity"), kind=kind)
    except RigidDirectionError:
        message("pm3dof: the tool is rigid in some direction: drawing compliance ellipsoids instead")
        _draw_ellipsoids(viewer, model, "compliance", None)
    except (SingularConfigurationError, DescriptionError) as error:
        if of == "stiffness" and others is None:  # fewer springs than motions: felt with the other motions free
            _draw_ellipsoids(viewer, model, of, "free")
            return
        if model is None or of not in _ELASTIC:
            message(f"pm3dof: ellipsoids are not drawn: {error}")
            return
        message(f"pm3dof: drawing velocity ellipsoids instead: {error}")
        _draw_ellipsoids(viewer, None, "velocity", None)


def _draw_polytopes(viewer: Viewer, limits: Mapping[str, Any]) -> None:
    """Draw what limits of the drives permit, hidden at first if they are only described; of a wrist, rotations."""
    if viewer.mechanism.tool_frame is None:
        return
    quantities: dict[PolytopeQuantity, str] = {"force": "effort", "speed": "speed"}
    for of, name in quantities.items():
        is_given = limits[name] is not None
        try:
            turns = all(unit_of(component) == "rad" for component in motion_components(viewer.configuration))
            viewer.capability_polytope(of, kind=_KINDS[turns], **limits, visible=is_given)
        except PM3DofError as error:  # such as a limit that the description lacks
            if is_given:
                message(f"pm3dof: no {of} polytope is drawn: {error}")


def _draw_load(viewer: Viewer, model: ElasticModel, shares: ToolComponent | None, *, visible: bool) -> None:
    """Draw the deflection under a load, and colour the legs by their share in it, or prepare the page to do so."""
    loads = [shares] if shares is not None else ["z", *TOOL_COMPONENTS]
    for load in loads:
        wrench = _LOAD * np.eye(6)[TOOL_COMPONENTS.index(load)]
        try:
            viewer.load(model, wrench, visible=visible)
            viewer.colour_legs(model, wrench, visible=shares is not None)
            return
        except PM3DofError:  # nothing deflects under this load
            if shares is not None:
                raise


def _compliance_on_path(model: ElasticModel, poses: Poses) -> list[Matrix] | None:
    try:
        return [cartesian_compliance(model, configuration).compliance for configuration in poses]
    except SingularConfigurationError as error:
        message(f"pm3dof: ellipsoids are not drawn: {error}")
        return None


def _draw_forces(viewer: Viewer, configuration: Configuration) -> None:
    if viewer.mechanism.description.floating_base:
        return  # nothing holds its weight
    try:
        forces = holding_forces(configuration).actuator_forces
    except SingularConfigurationError as error:
        message(f"pm3dof: forces are not drawn: {error}")
        return
    if forces.any():
        viewer.actuator_forces(forces, what="Holding forces")


def _draw_workspace(viewer: Viewer, quantity: str) -> None:
    try:
        viewer.workspace(quantity)
    except InvalidValueError as error:
        name = "--workspace" if error.name == "quantities" else f"--workspace {quantity}: {error.name}"
        raise InvalidValueError(name, error.value, error.expected) from error


def _limits_on_path(poses: Poses) -> list[str]:
    frames = int((~poses.within_limits).sum())
    return [f"in {frames} of {len(poses)} frames of the path"] if frames else []


def _poses_on_path(machine: Robot, path: Path, frames: int) -> tuple[Poses, Matrix | None]:
    """Read the poses of a path and interpolate frames between them, equally spaced; deflections too if it has them."""
    table = read_poses(machine, path)
    corners = table.poses.coordinates
    if len(corners) < 2:
        raise DescriptionError(path, "file", "expected at least two poses")
    if (missing := np.flatnonzero(~table.poses.solved)).size:
        raise UnreachablePoseError(f"{path}: pose {missing[0] + 1} is out of reach")
    places = np.linspace(0.0, len(corners) - 1.0, frames)

    def between(columns: Iterable[Array]) -> Matrix:
        return np.column_stack([np.interp(places, np.arange(len(corners)), column) for column in columns])

    values = between(corners.T)
    poses = machine.solve(values, on_failure="nan")
    for frame in np.flatnonzero(~poses.solved)[:1]:
        before = int(places[max(frame - 1, 0)]) + 1
        try:
            solve_pose(machine, values[frame])
        except UnreachablePoseError as error:
            raise UnreachablePoseError(f"{path}: between poses {before} and {before + 1}: {error}") from error
    found = [table.others[name] for name in _DEFLECTIONS if name in table.others]
    is_deflected = len(found) == len(_DEFLECTIONS) and np.isfinite(found).all() and np.any(found)
    return poses, between(found) if is_deflected else None
