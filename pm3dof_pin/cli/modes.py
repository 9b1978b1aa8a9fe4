"""`pm3dof modes`."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from pm3dof_pin.cli.options import Json, MachineOptions, Payload, PoseOptions, payloads_of
from pm3dof_pin.cli.output import fixed, table_lines
from pm3dof_pin.cli.poses import column_of, print_at_pose, solve_chosen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.batch import natural_frequencies
from pm3dof_pin.dynamics.modes import Modes, natural_modes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array, Vector


def modes(
    chosen: PoseOptions,
    which: MachineOptions,
    count: Annotated[int, typer.Option(min=1, help="Number of modes, lowest first.")] = 6,
    payload: Payload = 0.0,
    as_json: Json = False,
) -> None:
    """Compute natural frequencies and mode shapes at a pose: angles in degrees, lengths in metres.

    A mode shape is the twist of the tool, and with --json the motion of every joint, at unit modal mass: in m and rad
    per square root of kg m^2 / kg. Modes of frequency zero, which strain no spring, are listed separately. A pose that
    breaks a joint limit is still computed, with a message and exit status 1.
    """
    machine = which.load()
    model, payloads = ElasticModel(machine), payloads_of(machine, payload)

    def columns(poses: Poses) -> dict[str, Array]:
        frequencies = np.full((len(poses), count), np.nan)
        frequencies[poses.solved] = natural_frequencies(model, poses.q[poses.solved], count=count, payloads=payloads)
        return {column_of(f"mode{mode}", "Hz"): column for mode, column in enumerate(frequencies.T, start=1)}

    if (pose := solve_chosen(machine, chosen, columns, as_json)) is None:
        return
    result = {"payload_kg": payload, "within_limits": bool(pose.within_limits)}
    result |= _result(natural_modes(model, pose.configuration(), count=count, payloads=payloads))
    print_at_pose(pose, result, _lines(result), as_json=as_json)


def _result(found: Modes) -> dict[str, Any]:
    return {
        "frequency_Hz": found.frequencies,
        "tool_twists": list(found.twists.T),
        "joint_motions": [_by_joint(found, shape) for shape in found.shapes.T],
        "free_tool_twists": list(found.free_twists.T),
        "free_joint_motions": [_by_joint(found, motion) for motion in found.free_motions.T],
        "modes_without_mass": found.without_mass,
    }


def _by_joint(found: Modes, velocity: Vector) -> dict[str, Any]:
    """Name the entries of a velocity: a number for a single-DoF joint, a list for any other."""
    model = found.configuration.mechanism.model
    joints = list(zip(model.names, model.joints, strict=True))[1:]
    return {
        name: velocity[joint.idx_v] if joint.nv == 1 else velocity[joint.idx_v : joint.idx_v + joint.nv]
        for name, joint in joints
    }


def _lines(result: dict[str, Any]) -> list[str]:
    shapes = zip(result["frequency_Hz"], result["tool_twists"], strict=True)
    rows = [
        [str(mode + 1), f"{frequency:z.4f}", *(fixed(entry, 4) for entry in twist)]
        for mode, (frequency, twist) in enumerate(shapes)
    ]
    rows += [["free", "0", *(fixed(entry, 4) for entry in twist)] for twist in result["free_tool_twists"]]
    lines = table_lines(["mode", "frequency [Hz]", *TOOL_COMPONENTS], rows)
    if result["modes_without_mass"]:
        lines.append(f"motions that strain springs and move no mass: {result['modes_without_mass']}")
    return lines
