"""A page that answers what to type into a serial model, with the pictures of its transmission."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from matplotlib.figure import Figure

from pm3dof_pin.capability.serial_model import SerialModel, Spread
from pm3dof_pin.figures.html_page import html_image, html_page, html_table

_WORDS = {
    "torque_polytopes": "Torques that the drives can give at the joints, beyond those that hold the weight.",
    "speed_polytopes": "Speeds of the joints that all drives can follow.",
    "joint_maps": "What each joint feels of the rotors, and the greatest torque about it alone.",
    "drive_angles": "The drives against the joints.",
}


def transmission_report(
    robot: str, model: SerialModel, pictures: Mapping[str, Figure], functions: Sequence[str] = ()
) -> str:
    """Return the page as HTML: numbers for URDF and MJCF, how wrong each is over the box, and pictures.

    It has links to the files of the mapping as functions, relative to the page.
    """
    name = escape(robot)
    rows = [
        [joint, words, unit, *(f"{value:.4g}" for value in numbers), f"±{100.0 * error:.0f} %"]
        for words, units, spread in _quantities(model)
        for joint, unit, *numbers, error in zip(
            model.joints,
            [units[unit == "rad"] for unit in model.units],
            spread.least_wrong,
            spread.chosen("worst"),
            spread.least,
            spread.greatest,
            spread.error,
            strict=True,
        )
    ]
    ends = zip(model.lower, model.upper, model.units, strict=True)
    shown = [(np.degrees(low), np.degrees(high)) if unit == "rad" else (low, high) for low, high, unit in ends]
    box = ", ".join(
        f"{escape(joint)} {low:.4g} to {high:.4g} {'deg' if unit == 'rad' else unit}"
        for joint, (low, high), unit in zip(model.joints, shown, model.units, strict=True)
    )
    reach = "Every pose of the box is reached."
    if model.unreached:
        reach = (
            f"{100.0 * model.unreached:.1f} % of its poses are out of reach or beyond limits; in the box of "
            f"{model.reached_scale:.2f} times its size about the same centre all are reached."
        )
    coupling = ""
    if model.coupling:
        share = f"{100.0 * model.coupling:.0f} %"
        coupling = f" Rotors couple the joints by up to {share} of their own inertia, which is left out."
    mapping = "<code>--to numpy,jax,torch,casadi,c</code> writes the mapping between joints and drives as functions."
    if functions:
        links = ", ".join(f'<a href="{escape(file)}">{escape(file)}</a>' for file in functions)
        mapping = f"The mapping between joints and drives as functions, in rad and m: {links}."
    parts = [
        f"<h1>{name}: what to type into a serial model</h1>",
        f"<p>Over the box {box}. {reach}</p>",
        html_table(["joint", "number", "unit", "least wrong", "cautious", "least", "greatest", "off by"], rows),
        "<p>Each of these depends on the pose. The least wrong constant has the smallest greatest relative error over "
        "the box, given in the last column; the cautious one promises nothing that the machine cannot do. Efforts and "
        f"speeds are those about one joint alone.{coupling}</p>",
        "<h2>URDF</h2>",
        f"<pre>{escape(_urdf(model))}</pre>",
        "<h2>MJCF</h2>",
        f"<pre>{escape(_mjcf(model))}</pre>",
        "<p><code>pm3dof export serial</code> writes complete files, with the inertia of the loops' bodies too.</p>",
        f"<p>{mapping}</p>",
        "<h2>Pictures</h2>",
        *(f"<p>{_WORDS[key]}</p>{html_image(figure, _WORDS[key])}" for key, figure in pictures.items()),
    ]
    return html_page(f"Transmission of {name}", parts)


def _quantities(model: SerialModel) -> list[tuple[str, tuple[str, str], Spread]]:
    """Return words, units along and about an axis, and values of what is known."""
    rotors = model.armature if model.armature.greatest.any() else None
    found: list[tuple[str, tuple[str, str], Spread | None]] = [
        ("effort", ("N", "N m"), model.effort),
        ("velocity", ("m/s", "rad/s"), model.speed),
        ("armature of the rotors", ("kg", "kg m²"), rotors),
        ("inertia with all links", ("kg", "kg m²"), model.inertia),
        ("torque by a drive's effort", ("1", "1"), model.unit_torque),
        ("kp", ("N/m", "N m/rad"), model.gains.get("kp")),
        ("kd", ("N s/m", "N m s/rad"), model.gains.get("kd")),
    ]
    return [(words, units, spread) for words, units, spread in found if spread is not None]


def _urdf(model: SerialModel) -> str:
    lines = []
    for k, joint in enumerate(model.joints):
        limits = [f'lower="{model.lower[k]:.5g}"', f'upper="{model.upper[k]:.5g}"']
        for word, spread in (("effort", model.effort), ("velocity", model.speed)):
            limits.append(f'{word}="{spread.least_wrong[k]:.4g}"' if spread else f'{word}="..."')
        lines.append(f'<joint name="{joint}" ...> <limit {" ".join(limits)}/>')
    return "\n".join(lines)


def _mjcf(model: SerialModel) -> str:
    lines = []
    for k, joint in enumerate(model.joints):
        words = f'range="{model.lower[k]:.5g} {model.upper[k]:.5g}"'
        if model.armature.greatest.any():
            words += f' armature="{model.armature.least_wrong[k]:.4g}"'
        if model.effort:
            effort = model.effort.least_wrong[k]
            words += f' actuatorfrcrange="{-effort:.4g} {effort:.4g}"'
        lines.append(f'<joint name="{joint}" {words}/>')
    return "\n".join(lines)
