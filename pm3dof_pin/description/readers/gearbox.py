"""The gearbox joints of SDF, as couplings of the hinges on which its two wheels turn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import Description
from pm3dof_pin.description.origin import Origin

_PARALLEL = 1e-6  # greatest difference between a cosine and 1


def gearbox_coupling(
    tree: Description,
    wheels: Sequence[str],
    reference: str,
    axes: Sequence[Sequence[float]],
    ratio: float,
    origin: Origin,
) -> Coupling | str:
    """Return the coupling of a gearbox, or why it cannot be one.

    The angle from the reference body to the second wheel about the second axis is -ratio times that to the first wheel
    about the first (sdformat, `gearbox_reference_body`).

    Args:
        tree: the bodies and their joints.
        wheels: the parent and the child of the gearbox.
        reference: the body that carries both.
        axes: the two axes in the root, where all joints are at their zero.
        ratio: `gearbox_ratio`.
        origin: where it is described.
    """
    turns: list[tuple[str, float]] = []
    base = _rigid_top(tree, reference)
    for wheel, axis in zip(wheels, axes, strict=True):
        ends = {base, _rigid_top(tree, wheel)}
        hinges = [
            joint
            for joint in tree.joints
            if joint.type in ("revolute", "continuous")
            and {_rigid_top(tree, joint.parent), _rigid_top(tree, joint.child)} == ends
        ]
        if len(hinges) != 1 or len(ends) != 2:
            return f"expected a hinge of the tree between '{wheel}' and its gearbox_reference_body '{reference}'"
        cosine = float(np.dot(axis, tree.axis_in_root(hinges[0])))
        if abs(abs(cosine) - 1.0) > _PARALLEL:
            return f"expected its axis to be that of joint '{hinges[0].name}'"
        turns.append((hinges[0].name, np.sign(cosine) * (1 if _rigid_top(tree, hinges[0].parent) == base else -1)))
    (first, a), (second, b) = turns
    if first == second or not ratio:
        return "expected two joints and a ratio other than zero"
    return Coupling.from_powers(second, first, (0.0, -ratio * float(a * b)), origin)


def _rigid_top(tree: Description, body: str) -> str:
    """Return the highest body that fixed joints connect to a body."""
    while (joint := tree.joint_above.get(body)) is not None and joint.is_fixed:
        body = joint.parent
    return body
