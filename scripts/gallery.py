"""Take the pictures of the documentation's gallery with a headless browser.

They are written under results/gallery/, or with --out docs/pictures where the documentation shows them; the social card
belongs into docs/static.
"""

from __future__ import annotations

import argparse
import base64
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Motion
from pm3dof_pin.viewer import Viewer
from pm3dof_pin.viewer.browser import Browser, find_browser
from pm3dof_pin.viewer.ellipsoids import EllipsoidMatrix

RESULTS = Path(__file__).resolve().parents[1] / "results" / "gallery"
SIZE = {"width": 1000, "height": 750}
CARD = """<body style="margin: 0; background: #fff; color: #1b2430; font-family: 'DejaVu Sans', sans-serif">
<img src="data:image/png;base64,{machine}" style="position: absolute; right: 0; top: 0">
<div style="position: absolute; left: 64px; top: 190px; width: 500px">
{logo}<h1 style="font-size: 60px; margin: 20px 0 14px">pm3dof-pin</h1>
<p style="font-size: 29px; line-height: 1.35; margin: 0">
Stiffness, errors and calibration of robots with closed loops</p></div></body>"""
KINDS: tuple[Motion, Motion] = ("translation", "rotation")


def main(folder: Path = RESULTS) -> None:
    require_browser()
    folder.mkdir(parents=True, exist_ok=True)

    with tripod_at(10.0, -15.0, 0.5) as (viewer, model):
        draw_ellipsoids(viewer, model, "stiffness")
        draw_forces(viewer)
        print(viewer.save_picture(folder / "viewer_stiffness.png", **SIZE))

    with tripod_at(-22.0, 18.0, 0.47) as (viewer, model):
        draw_ellipsoids(viewer, model, "compliance")
        viewer.colour_legs(model)
        viewer.frames()
        print(viewer.save_picture(folder / "viewer_compliance.png", **SIZE))

    with tripod_at(12.0, 20.0, 0.49) as (viewer, _):
        viewer.workspace("translational_stiffness:least")
        viewer.look(closeness=1.1)
        print(viewer.save_picture(folder / "viewer_workspace.png", **SIZE))

    for robot in ("hexapod", "three_rps"):
        with Viewer(Robot.load(robot)) as viewer:
            model = ElasticModel(viewer.mechanism)
            draw_ellipsoids(viewer, model, "stiffness")
            draw_forces(viewer)
            viewer.colour_legs(model, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            print(viewer.save_picture(folder / f"viewer_{robot}.png", **SIZE))

    with Viewer(Robot.load("hexapod")) as viewer:
        draw_ellipsoids(viewer, ElasticModel(viewer.mechanism), "stiffness")
        viewer.capability_polytope("force", effort=500.0)
        viewer.capability_polytope("speed", speed=0.1)
        print(viewer.save_picture(folder / "viewer_capability.png", **SIZE))

    print(social_card(folder))

    if find_spec("example_robot_data") is None:
        sys.exit("the last picture shows an arm of example-robot-data: pip install 'pm3dof-pin[robots]'")
    with serial_arm() as (viewer, model):
        draw_ellipsoids(viewer, model, "compliance")
        draw_forces(viewer)
        viewer.colour_legs(model)
        print(viewer.save_picture(folder / "viewer_arm.png", **SIZE))


def require_browser() -> None:
    """Report at once that a browser is missing."""
    try:
        find_browser()
    except PM3DofError as error:
        sys.exit(f"a browser takes the pictures: {error}")


def social_card(folder: Path) -> Path:
    """Draw the picture that links to the documentation show: the logo, a name, and the hexapod under a load."""
    logo = (Path(__file__).resolve().parents[1] / "docs" / "static" / "logo.svg").read_text(encoding="utf-8")
    with Viewer(Robot.load("hexapod")) as viewer:
        model = ElasticModel(viewer.mechanism)
        draw_ellipsoids(viewer, model, "stiffness")
        viewer.load(model, [60.0, 0.0, -80.0, 0.0, 0.0, 0.0])
        (machine,) = Browser.pictures_of(viewer.html(), 640, 630, bare=True)
    page = CARD.format(logo=logo, machine=base64.b64encode(machine).decode())
    with Browser(1200, 630) as browser:
        browser.open(f"data:text/html;base64,{base64.b64encode(page.encode()).decode()}")
        (folder / "social_card.png").write_bytes(browser.picture())
    return folder / "social_card.png"


@contextmanager
def tripod_at(theta_x: float, theta_y: float, z_e: float) -> Iterator[tuple[Viewer, ElasticModel]]:
    """Angles in degrees, the height in metres."""
    robot = Robot.load("pm3dof")
    with Viewer(robot) as viewer:
        viewer.display(robot.solve([np.radians(theta_x), np.radians(theta_y), z_e]).configuration())
        yield viewer, ElasticModel(robot)


@contextmanager
def serial_arm() -> Iterator[tuple[Viewer, ElasticModel]]:
    """A UR5 of example-robot-data, which comes with the test extra, with springs at its joints."""
    import example_robot_data

    arm = example_robot_data.load("ur5")
    mechanism = Robot(arm.model, tool_frame="ee_link")
    stiffness = (4e4, 4e4, 2e4, 1e4, 1e4, 1e4)
    springs = [
        JointSpring(name, name, k, "N m/rad") for name, k in zip(mechanism.actuated_joints, stiffness, strict=True)
    ]
    model = ElasticModel(mechanism, springs)
    with Viewer(mechanism, model=model, visuals=arm.visual_model) as viewer:
        viewer.display([0.3, -1.2, 1.4, -1.0, -1.5, 0.2])
        yield viewer, model


def draw_ellipsoids(viewer: Viewer, model: ElasticModel, of: EllipsoidMatrix) -> None:
    compliance = cartesian_compliance(model, viewer.configuration).compliance
    for kind in KINDS:
        viewer.stiffness_ellipsoid(compliance=compliance, kind=kind, of=of)


def draw_forces(viewer: Viewer) -> None:
    viewer.actuator_forces(holding_forces(viewer.configuration).actuator_forces, what="Holding forces")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the pictures")
    main(parser.parse_args().out)
