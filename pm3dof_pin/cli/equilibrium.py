"""`pm3dof equilibrium`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.cli.options import Json, MachineOptions, Payload, PoseOptions, Wrench
from pm3dof_pin.cli.output import fixed, table_lines
from pm3dof_pin.cli.poses import column_of, print_at_pose, solve_chosen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.elastic.elastic_model import ElasticModel, SpringBlock
from pm3dof_pin.elastic.loaded import LoadedEquilibrium, loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.springs import BeamSpring, CantileverSpring, Spring
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array, Vector


def equilibrium(
    chosen: PoseOptions,
    which: MachineOptions,
    wrench: Wrench = None,
    payload: Payload = 0.0,
    weightless: bool = False,
    as_json: Json = False,
) -> None:
    """Compute where the tool rests under load, and the state of every contact: angles in degrees, lengths in metres.

    The machine's own weight, a payload at the tool point and a wrench act; the commands are held. Springs with a law
    (preload, play, progressive) follow it: play closes where the loads press the parts together. Displacements are
    relative to the weightless machine with every part in the middle of its play.
    """
    robot = which.load()
    model = ElasticModel(robot)
    tool = robot.frame_name()
    applied = finite_array("wrench", np.zeros(6) if wrench is None else wrench, (6,))
    loads = Loads({tool: applied}, {tool: payload}, own_weight=not weightless)
    pose = solve_chosen(robot, chosen, lambda poses: _columns(model, poses, loads), as_json)
    if pose is None:
        return
    found = loaded_equilibrium(model, pose.q, loads)
    result: dict[str, Any] = {
        "payload_kg": payload,
        "own_weight": loads.own_weight,
        "wrench": applied,
        "displacement": dict(zip(TOOL_COMPONENTS, found.displacement(), strict=True)),
        "residual_N": found.residual,
        "stable": found.stable,
        "contacts": [_contact(block, d) for block, d in _contacts(model, found)],
        "units": {"displacement": "m, rad", "wrench": "N, N m"},
    }
    if result["contacts"]:
        linear = ElasticModel(robot, [_linear(spring) for spring in model.springs])
        without = loaded_equilibrium(linear, pose.q, loads).displacement()
        result["displacement_of_linear_springs"] = dict(zip(TOOL_COMPONENTS, without, strict=True))
    print_at_pose(pose, result, _lines(result), as_json=as_json)


def _columns(model: ElasticModel, poses: Poses, loads: Loads) -> dict[str, Array]:
    """Return the displacements at many poses, and the force and state of each contact; NaN where there is none."""
    names = [block.name for block in model.blocks if block.law is not None]
    table, states = np.full((len(poses), 6 + len(names)), np.nan), np.full((len(poses), len(names)), "", dtype=object)
    for row in np.flatnonzero(poses.solved):
        try:
            found = loaded_equilibrium(model, poses.q[row], loads)
        except PM3DofError:
            states[row] = "no equilibrium"
            continue
        contacts = [_contact(block, d) for block, d in _contacts(model, found)]
        table[row] = [*found.displacement(), *(contact["force_N"] for contact in contacts)]
        states[row] = [contact["state"] for contact in contacts]
    units = ["m"] * 3 + ["rad"] * 3
    headings = [column_of(f"d_{name}", unit) for name, unit in zip(TOOL_COMPONENTS, units, strict=True)]
    columns = dict(zip([*headings, *(column_of(name, "N") for name in names)], table.T, strict=True))
    return columns | {f"{name}_state": column for name, column in zip(names, states.T, strict=True)}


def _contacts(model: ElasticModel, found: LoadedEquilibrium) -> list[tuple[SpringBlock, Vector]]:
    deflections = found.spring_deflections
    pairs = zip(model.blocks, model.spring_slices, strict=True)
    return [(block, deflections[rows]) for block, rows in pairs if block.law is not None]


def _contact(block: SpringBlock, deflection: Vector) -> dict[str, Any]:
    """Describe a contact: the deflection along its only direction, or its amount."""
    assert block.law is not None
    stiffness, amount = float(block.coefficients[0, 0]), float(np.linalg.norm(deflection))
    force, tangent = block.law.force(stiffness, amount)
    sign = np.copysign(1.0, deflection[0]) if len(deflection) == 1 else 1.0
    return {
        "name": block.name,
        "state": block.law.state(stiffness, amount),
        "deflection_m": sign * amount,
        "force_N": sign * force,
        "stiffness_N_per_m": tangent,
    }


def _linear(spring: Spring) -> Spring:
    return spring if isinstance(spring, (CantileverSpring, BeamSpring)) else replace(spring, law=None)


def _lines(result: dict[str, Any]) -> list[str]:
    linear = result.get("displacement_of_linear_springs")
    rows = []
    for k, (name, value) in enumerate(result["displacement"].items()):
        unit = "um" if k < 3 else "urad"
        rows.append([name, fixed(1e6 * value, 3), *([fixed(1e6 * linear[name], 3)] if linear else []), unit])
    header = ["tool", "displacement", *(["with linear springs"] if linear else []), ""]
    lines = table_lines(header, rows)
    if result["contacts"]:
        rows = [
            [
                contact["name"],
                contact["state"],
                fixed(contact["force_N"], 2),
                fixed(1e6 * contact["deflection_m"], 3),
                f"{contact['stiffness_N_per_m']:.3e}",
            ]
            for contact in result["contacts"]
        ]
        header = ["contact", "state", "force [N]", "deflection [um]", "stiffness [N/m]"]
        lines += ["", *table_lines(header, rows)]
    if any(contact["state"] == "open" for contact in result["contacts"]):
        lines += ["", "open: the loads do not close this play, and the parts may be anywhere in it"]
    if not result["stable"]:
        lines += ["", "the equilibrium is not stable"]
    return [*lines, "", f"residual {result['residual_N']:.1e} N"]
