"""What is read off a configuration, as a program: coordinates, commands, and the placement of the tool."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.programs.closing import placement_component
from pm3dof_pin.programs.graph import Graph, Scalar, atan2
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree


def readings_program(
    mechanism: Mechanism, groups: Mapping[str, Iterable[Coordinate]], samples: ArrayLike, *, dense: bool = False
) -> Program:
    """Record the values of coordinates at a configuration.

    The input is q. Outputs: one group for each of `groups`, in the coordinates' order and units; and, if the mechanism
    has a tool, its `transform` in the world, shape=(4, 4). Angles of joints that turn without end are in (-pi, pi].

    Raises:
        ProgramError: the model has a joint of an unsupported type.
        InvalidValueError: the samples have the wrong shape.
    """
    graph = Graph()
    tree = Tree(graph, mechanism, samples, dense=dense)
    outputs: dict[str, Any] = {name: [_value(tree, each) for each in members] for name, members in groups.items()}
    if mechanism.tool_frame is not None:
        tool = tree.frame(mechanism.tool_frame)
        rows = [[*tool.rotation[i], tool.translation[i]] for i in range(3)]
        outputs["transform"] = [*rows, [0.0, 0.0, 0.0, 1.0]]
    return graph.program("readings", outputs)


def _value(tree: Tree, coordinate: Coordinate) -> Scalar:
    if coordinate.joint is None:
        assert coordinate.tool is not None
        return placement_component(tree.frame(tree.mechanism.frame_name()), coordinate.tool)
    joint = tree.mechanism.single_joint(coordinate.joint)
    value: Scalar = tree.q[joint.q_index]
    if joint.is_continuous:
        value = atan2(tree.q[joint.q_index + 1], value)
    return value * coordinate.scale + coordinate.offset
