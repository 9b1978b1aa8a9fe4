"""Checks of a closed configuration, as a program: residual, broken limits, branch, tool placement."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.programs.closing import Task, branch_number
from pm3dof_pin.programs.graph import Graph, Scalar, Truth, less, select, sqrt
from pm3dof_pin.programs.loops import closure_residual, swing
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree


def checks_program(
    mechanism: Mechanism, samples: ArrayLike, task: Task | None = None, *, dense: bool = False
) -> Program:
    """Record the checks of a configuration, at closed samples, shape=(s, nq), see :class:`Tree`.

    The input is q. Outputs: `residual`, the largest closure error [m, rad]; `broken`, the sum of 2^(k + 1) over the
    mechanism's limit groups k with a limit exceeded by more than the tolerance in
    :mod:`pm3dof_pin.programs.geometry`; `branch`, if a task is given and there are loops, see
    :func:`~pm3dof_pin.programs.closing.branch_number`; and, if the mechanism has a tool, its `transform` in the world,
    shape=(4, 4).

    Raises:
        ProgramError: the model has a joint of an unsupported type.
        InvalidValueError: the samples have the wrong shape.
    """
    graph = Graph()
    tree = Tree(graph, mechanism, samples, dense=dense)
    broken: Scalar = 0.0
    for bit, group in enumerate(mechanism.limit_groups, 1):
        conditions = [condition for name in group.joints for condition in _beyond_range(tree, name)]
        conditions += [condition for index in group.closures for condition in _beyond_swing(tree, index)]
        if conditions:
            is_broken = conditions[0]
            for condition in conditions[1:]:
                is_broken = is_broken | condition
            broken = broken + select(is_broken, 2.0**bit, 0.0)
    outputs: dict[str, Any] = {"residual": closure_residual(tree), "broken": broken}
    if task is not None and mechanism.has_branches:
        outputs["branch"] = branch_number(tree, task, mechanism.branching_drives)
    if mechanism.tool_frame is not None:
        tool = tree.frame(mechanism.tool_frame)
        rows = [[*tool.rotation[i], tool.translation[i]] for i in range(3)]
        outputs["transform"] = [*rows, [0.0, 0.0, 0.0, 1.0]]
    return graph.program("checks", outputs)


def _beyond_range(tree: Tree, name: str) -> list[Truth]:
    mechanism = tree.mechanism
    joint = mechanism.model.joints[mechanism.model.getJointId(name)]
    conditions: list[Truth] = []
    for k in range(joint.idx_q, joint.idx_q + joint.nq):
        if np.isfinite(mechanism.lower_limits[k]):
            conditions.append(less(tree.q[k], tree.geometry.limit(f"limit/{k}/lower")))
        if np.isfinite(mechanism.upper_limits[k]):
            conditions.append(less(tree.geometry.limit(f"limit/{k}/upper"), tree.q[k]))
    return conditions


def _beyond_swing(tree: Tree, index: int) -> list[Truth]:
    if tree.mechanism.closures[index].swing_limit is None:
        return []
    square, cosine = swing(tree, index)
    sine_limit, cosine_limit = (tree.geometry.limit(f"swing/{index}/{name}") for name in ("sine", "cosine"))
    # the sine of the angle minus its limit, which is accurate at every angle
    return [less(cosine * sine_limit, sqrt(square) * cosine_limit)]
