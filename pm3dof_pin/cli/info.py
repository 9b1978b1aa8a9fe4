"""`pm3dof info`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.options import Json
from pm3dof_pin.cli.output import print_result, table_lines

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

RobotName = Annotated[
    str, typer.Option("--robot", metavar="NAME|URDF", help="A robot by name, or the path of its URDF.")
]


def info(robot: RobotName = "pm3dof", as_json: Json = False) -> None:
    """What a robot is: files, joints, loop closures, freedoms, home pose; and which robots there are."""
    import numpy as np

    from pm3dof_pin.description.robots import find_robot, robot_names
    from pm3dof_pin.kinematics.mobility import instantaneous_mobility
    from pm3dof_pin.kinematics.robot import Robot

    files = find_robot(robot)
    mechanism = Robot.load(robot)
    home = mechanism.home
    mobility = instantaneous_mobility(home)
    result: dict[str, Any] = {
        "name": mechanism.name,
        "urdf": str(files.urdf),
        "closures_file": str(files.closures),
        "joints": len(mechanism.model.names) - 1,
        "actuated_joints": mechanism.actuated_joints,
        "closures": [
            {"frame_a": closure.frame_a, "frame_b": closure.frame_b, "type": closure.type}
            for closure in mechanism.closures
        ],
        "tool_frame": mechanism.tool_frame,
        "mobility": mobility.count,
        "tool_mobility": mobility.tool_mobility,
        "redundant_constraints": mobility.redundant_constraints,
        "home_closure_residual": home.closure_residual,
        "home_tool_position_m": home.tool_placement.translation,
        "moving_mass_kg": float(np.sum([inertia.mass for inertia in list(mechanism.model.inertias)[1:]])),
        "named_configurations": list(mechanism.named_configurations),
        "robots": robot_names(),
    }
    print_result(result, _lines(result, mechanism), as_json=as_json)


def _lines(result: dict[str, Any], mechanism: Robot) -> list[str]:
    x, y, z = result["home_tool_position_m"]
    closures = ", ".join(f"{c['frame_a']}-{c['frame_b']} ({c['type']})" for c in result["closures"])
    facts = [
        f"{result['name']}: {result['joints']} joints, {len(result['actuated_joints'])} of them actuated, "
        f"{len(result['closures'])} loop closures",
        f"mobility {result['mobility']} ({result['tool_mobility']} of the tool), "
        f"{result['redundant_constraints']} redundant constraints",
        f"tool {result['tool_frame']}, at home x = {x:.6f}, y = {y:.6f}, z = {z:.6f} m",
        f"closures: {closures or 'none'}, residual at home {result['home_closure_residual']:.1e}",
        f"moving mass {result['moving_mass_kg']:.4f} kg",
        f"description {result['urdf']}",
        f"closures file {result['closures_file']}",
        f"named configurations: {', '.join(result['named_configurations']) or 'none'}",
        f"robots that come with the package: {', '.join(result['robots'])}",
        "",
    ]
    rows = [
        [
            name,
            "actuated" if name.partition("[")[0] in mechanism.actuated_joints else "passive",
            *(f"{limits[index]:.4g}" for limits in (mechanism.lower_limits, mechanism.upper_limits)),
        ]
        for index, name in enumerate(mechanism.q_names)
    ]
    return facts + table_lines(["joint", "", "lower [m, rad]", "upper [m, rad]"], rows)
