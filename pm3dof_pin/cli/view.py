"""`pm3dof view`."""

from __future__ import annotations

import logging
import signal
import threading
from enum import StrEnum
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from pm3dof_pin.cli.options import (
    THE_TRIPOD,
    NamedConfiguration,
    OptionalHeight,
    OptionalThetaX,
    OptionalThetaY,
    RobotName,
    Target,
    pose_of,
)
from pm3dof_pin.cli.output import message, stop_on_broken_limits

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.elastic.elastic_model import ElasticModel
    from pm3dof_pin.elastic.indices import OtherMotions
    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.mechanism.configuration import Configuration
    from pm3dof_pin.viewer import Viewer

_FRAMES_PER_SECOND = 20
_FOR_EVER = 10_000  # repetitions of a path


class Quantity(StrEnum):
    """What the ellipsoids show."""

    STIFFNESS = "stiffness"
    COMPLIANCE = "compliance"


class Others(StrEnum):
    """What the other three motions do while an ellipsoid's three are probed."""

    FREE = "free"
    HELD = "held"


class Load(StrEnum):
    """A unit force or moment at the tool, along or about an axis of the base."""

    X = "x"
    Y = "y"
    Z = "z"
    RX = "rx"
    RY = "ry"
    RZ = "rz"


def view(
    theta_x: OptionalThetaX = None,
    theta_y: OptionalThetaY = None,
    z_e: OptionalHeight = None,
    robot: RobotName = None,
    configuration: NamedConfiguration = None,
    of: Annotated[Quantity, typer.Option(help="What the ellipsoids show.")] = Quantity.STIFFNESS,
    others: Annotated[
        Others | None,
        typer.Option(help="The other three motions: free or held; by default held for stiffness, free for compliance."),
    ] = None,
    forces: Annotated[
        bool, typer.Option(help="Arrows for the actuator forces that hold the weight; not along a path.")
    ] = True,
    frames: Annotated[bool, typer.Option(help="Frames of the tool and the loop closures.")] = False,
    shares: Annotated[
        Load | None,
        typer.Option(metavar="LOAD", help="Colour the legs by their share in the compliance: x, y, z, rx, ry, rz."),
    ] = None,
    workspace: Annotated[
        str | None,
        typer.Option(
            metavar="QUANTITY",
            help="Boundary of the workspace in the colours of a quantity, as condition_number or felt_stiffness:z.",
        ),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Play a path: a text file with TX TY Z [deg, deg, m] in each line."),
    ] = None,
    duration: Annotated[float, typer.Option(min=0.1, help="Time of the whole path [s].")] = 6.0,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write one page that needs no network, and leave.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a picture (PNG), and leave; needs Chromium or Chrome.")
    ] = None,
    size: Annotated[tuple[int, int], typer.Option(min=64, metavar="W H", help="Size of the picture [pixels].")] = (
        1200,
        900,
    ),
    host: Annotated[
        str, typer.Option(help="Interface to listen on. Others than this machine's own can be reached by everybody.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port to listen on; the first free one from 7000 by default.")
    ] = None,
    browser: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """The machine in a browser, with its stiffness ellipsoids at the tool: angles in degrees, height in metres.

    With sliders for theta_x, theta_y and z_e where the robot is the tripod. Serves the page until Ctrl-C, to this
    machine only. A pose that breaks a joint limit is still shown, with a message (and exit status 1 for --html and
    --picture).
    """
    import numpy as np

    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.viewer import Viewer

    if path is not None and (theta_x is not None or configuration is not None):
        raise typer.BadParameter("--path: the file has the poses; expected no TX TY Z or --configuration beside it")
    if path is not None and shares is not None:
        raise typer.BadParameter("--shares: legs are not coloured along a --path")
    nothing = theta_x is None and robot is None and configuration is None
    target = Target.of(theta_x, theta_y, z_e, THE_TRIPOD if nothing else robot, configuration)
    mechanism = Robot.load(target.robot)
    tripod = _tripod_of(target.robot, mechanism)
    for option, wanted in (("--workspace", workspace), ("--path", path)):
        if wanted is not None and tripod is None:
            raise typer.BadParameter(f"{option}: only the tripod has one, not {mechanism.name}")
    where = target.configuration(mechanism)
    broken = target.broken_limits(where)
    with Viewer(mechanism, tripod=tripod, host=host, port=port) as viewer:
        viewer.display(where)
        model = _elastic_model(mechanism)
        other: OtherMotions | None = None if others is None else others.value
        if path is not None and tripod is not None:
            poses = _path_poses(path, max(2, round(_FRAMES_PER_SECOND * duration) + 1))
            broken = _limits_on_path(tripod, poses)
            places = _configurations(mechanism, tripod, poses)
            stiffness = [matrix for place in places if (matrix := _stiffness(model, place)) is not None]
            viewer.play(
                places, stiffness=stiffness or None, of=of.value, others=other, duration=duration, repetitions=_FOR_EVER
            )
        elif (matrix := _stiffness(model, where)) is not None:
            viewer.stiffness_ellipsoid(matrix, kind="translation", of=of.value, others=other)
            viewer.stiffness_ellipsoid(matrix, kind="rotation", of=of.value, others=other)
        if forces and path is None:
            _draw_forces(viewer, where)
        if shares is not None and path is None and model is not None:
            viewer.colour_legs(model, np.eye(6)[list(Load).index(shares)])
        if frames:
            viewer.frames()
        if workspace is not None and tripod is not None:
            _draw_workspace(viewer, tripod, workspace)
        if html is None and picture is None:
            _serve(viewer, broken, browser)
            return
        if html is not None:
            message(f"wrote {viewer.save_html(html)}")
        if picture is not None:
            message(f"wrote {viewer.save_picture(picture, width=size[0], height=size[1])}")
    stop_on_broken_limits(broken)


def _serve(viewer: Viewer, broken: Sequence[str], browser: bool) -> None:
    """Serve the page until Ctrl-C or SIGTERM."""
    from pm3dof_pin.viewer.server import is_loopback

    logging.getLogger("pm3dof_pin.viewer.server").setLevel(logging.ERROR)  # its warning is given below
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
            message(f"pm3dof: warning: listening on {viewer.host}: everybody who reaches this machine can see the page")
        if browser and not viewer.open():
            message("no browser could be opened here: open the address yourself")
        stop.wait()
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        viewer.close()
    message("closed")


def _tripod_of(robot: str, mechanism: Robot) -> Tripod | None:
    """Return the closed form of a robot of the tripod's family: its parameter file is ../config/<name>.yaml."""
    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.description.robots import find_robot

    urdf = find_robot(robot).urdf
    config = urdf.resolve().parent.parent / "config" / f"{urdf.stem}.yaml"
    own = {"platform_x_joint", "platform_y_joint", "passive_slider_joint", "slider1_joint"}
    if not own <= set(mechanism.q_names) or not config.is_file():
        return None
    return Tripod.load(config)


def _elastic_model(mechanism: Robot) -> ElasticModel | None:
    from pm3dof_pin.elastic.elastic_model import ElasticModel

    if not mechanism.springs:
        message(f"pm3dof: {mechanism.name} has no springs in its description: no ellipsoids are drawn")
        return None
    return ElasticModel(mechanism)


def _stiffness(model: ElasticModel | None, where: Configuration) -> NDArray[np.float64] | None:
    from pm3dof_pin.elastic.condensation import cartesian_compliance
    from pm3dof_pin.exceptions import SingularConfigurationError

    if model is None:
        return None
    try:
        return cartesian_compliance(model, where).stiffness
    except SingularConfigurationError as error:
        message(f"pm3dof: no ellipsoids are drawn: {error}")
        return None


def _draw_forces(viewer: Viewer, where: Configuration) -> None:
    from pm3dof_pin.dynamics.statics import holding_forces
    from pm3dof_pin.exceptions import SingularConfigurationError

    try:
        held = holding_forces(where).actuator_forces
    except SingularConfigurationError as error:
        message(f"pm3dof: no forces are drawn: {error}")
        return
    if held.any():
        viewer.actuator_forces(held, what="Holding forces")


def _draw_workspace(viewer: Viewer, tripod: Tripod, quantity: str) -> None:
    from pm3dof_pin.exceptions import InvalidValueError

    try:
        viewer.workspace(tripod, quantity)
    except InvalidValueError as error:
        raise InvalidValueError("--workspace", quantity, error.expected) from error


def _configurations(mechanism: Robot, tripod: Tripod, poses: NDArray[np.float64]) -> list[Configuration]:

    return list(mechanism.solve(poses))


def _limits_on_path(tripod: Tripod, poses: NDArray[np.float64]) -> list[str]:
    from pm3dof_pin.chapter.limits import broken_limits

    frames = int((broken_limits(tripod, poses) != 0).sum())
    return [f"in {frames} of {len(poses)} frames of the path"] if frames else []


def _path_poses(path: Path, frames: int) -> NDArray[np.float64]:
    """Read the poses of a path and fill in frames between them, equally spaced along its lines."""
    import numpy as np

    corners = np.array(_read_path(path))
    places = np.linspace(0.0, len(corners) - 1.0, frames)
    return np.column_stack([np.interp(places, np.arange(len(corners)), column) for column in corners.T])


def _read_path(path: Path) -> list[NDArray[np.float64]]:
    import math

    from pm3dof_pin.exceptions import DescriptionError

    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(path, "file", f"expected a readable text file ({error})") from error
    poses = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            theta_x, theta_y, z_e = (float(word) for word in words)
        except ValueError as error:
            raise DescriptionError(path, f"line {number}", "expected three numbers: TX TY Z [deg, deg, m]") from error
        if not all(map(math.isfinite, (theta_x, theta_y, z_e))):
            raise DescriptionError(path, f"line {number}", "expected finite numbers")
        poses.append(pose_of(theta_x, theta_y, z_e))
    if len(poses) < 2:
        raise DescriptionError(path, "file", "expected two poses at least, a line each: TX TY Z [deg, deg, m]")
    return poses
