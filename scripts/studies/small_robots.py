"""Two dozen small robots as users write them, each a URDF and a closures file: planar, spherical, spatial, serial."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

X, Y, Z = np.eye(3)
RANGES = {"prismatic": (-0.06, 0.06), "revolute": (-0.7, 0.7)}
THREE = (90.0, 210.0, 330.0)


class Joint(NamedTuple):
    """A joint of a leg, by its axis and a point on it at home; a ball has no axis."""

    kind: str  #: "revolute", "prismatic" or "ball"
    axis: np.ndarray
    at: np.ndarray
    driven: bool = False


class Writer:
    """Writes a robot whose links are parallel to the world at home."""

    def __init__(self, name: str) -> None:
        self.name, self.at = name, {"base": np.zeros(3)}
        self.joints: list[str] = []
        self.closures: list[tuple[str, str, str]] = []
        self.drives: list[str] = []

    def joint(self, parent: str, joint: Joint, limits: tuple[float, float] | None = None) -> str:
        """Add a joint and its link, and return the link."""
        name, child = f"joint{len(self.joints)}", f"link{len(self.joints)}"
        x, y, z = joint.axis / np.linalg.norm(joint.axis)
        low, high = limits or RANGES[joint.kind]
        self._add(
            name,
            joint.kind,
            parent,
            child,
            joint.at,
            f'<axis xyz="{x:.15g} {y:.15g} {z:.15g}"/><limit lower="{low}" upper="{high}" effort="100" velocity="1"/>',
        )
        if joint.driven:
            self.drives.append(name)
        return child

    def fixed(self, parent: str, name: str, at: Iterable[float]) -> str:
        """Mark a place of a link."""
        self._add(f"{name}_fixed", "fixed", parent, name, np.array(list(at)), "")
        return name

    def save(self, folder: Path, tool: str, motions: Sequence[str] = ()) -> Path:
        """Write the robot."""
        folder.mkdir(parents=True, exist_ok=True)
        links = "".join(f'<link name="{link}"/>' for link in self.at)
        path = folder / f"{self.name}.urdf"
        path.write_text(f'<robot name="{self.name}">{links}{"".join(self.joints)}</robot>')
        lines = [f"name_mot: [{', '.join(self.drives)}]", f"tool_frame: {tool}"]
        if self.closures:
            lines.append(f"closed_loop: [{', '.join(f'[{a}, {b}]' for a, b, _ in self.closures)}]")
            lines.append("type: [" + ", ".join(f"'{kind}'" for *_, kind in self.closures) + "]")
        if motions:
            lines.append(f"tool_motions: [{', '.join(motions)}]")
        (folder / f"{self.name}.closures.yaml").write_text("\n".join(lines) + "\n")
        return path

    def _add(self, name: str, kind: str, parent: str, child: str, at: np.ndarray, rest: str) -> None:
        x, y, z = at - self.at[parent]
        self.at[child] = at
        self.joints.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{x:.15g} {y:.15g} {z:.15g}"/>{rest}</joint>'
        )


def revolute(axis: np.ndarray, at: Iterable[float], driven: bool = False) -> Joint:
    """Return a hinge."""
    return Joint("revolute", axis, np.array(list(at), dtype=float), driven)


def slider(axis: np.ndarray, at: Iterable[float], driven: bool = True) -> Joint:
    """Return a slider, driven by default."""
    return Joint("prismatic", axis, np.array(list(at), dtype=float), driven)


def ball(at: np.ndarray) -> Joint:
    """Return a ball joint."""
    return Joint("ball", Z, at)


def platform(
    name: str, legs: Sequence[Sequence[Joint]], tool: Iterable[float], folder: Path, motions: Sequence[str] = ()
) -> Path:
    """Write a platform on legs: the first carries it, the others are closed at their last joint, or welded to it."""
    writer, top = Writer(name), ""
    for number, leg in enumerate(legs):
        link = "base"
        for joint in leg:
            if joint.kind != "ball":
                link = writer.joint(link, joint)
            elif not top:
                for axis in np.eye(3):
                    link = writer.joint(link, revolute(axis, joint.at))
        if top:
            at, kind = leg[-1].at, "3d" if leg[-1].kind == "ball" else "6d"
            ends = (writer.fixed(link, f"tip{number}", at), writer.fixed(top, f"mount{number}", at))
            writer.closures.append((*ends, kind))
        top = top or link
    return writer.save(folder, writer.fixed(top, "tool", tool), motions)


def ring(radius: float, degrees: Iterable[float], height: float = 0.0) -> np.ndarray:
    """Return points on a circle about z."""
    angles = np.radians(list(degrees))
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), height + 0.0 * angles], axis=1)


def across(direction: np.ndarray) -> np.ndarray:
    """Return a horizontal direction across one."""
    return np.asarray(np.cross(direction, Z if np.linalg.norm(np.cross(direction, Z)) > 1e-3 else X))


def strut(below: np.ndarray, above: np.ndarray) -> list[Joint]:
    """Return a driven strut: a universal joint, a slider, a ball."""
    along = above - below
    side = across(along)
    middle = 0.5 * (below + above)
    return [revolute(side, below), revolute(np.cross(along, side), below), slider(along, middle), ball(above)]


def three_legs(leg: Callable[[np.ndarray, np.ndarray], list[Joint]]) -> list[list[Joint]]:
    """Return legs by their outward and sideward directions."""
    return [leg(out, np.cross(Z, out)) for out in ring(1.0, THREE)]


def rod(out_point: np.ndarray, in_point: np.ndarray, side: np.ndarray) -> list[Joint]:
    """Return a rod between two universal joints whose outer axes are `side`."""
    other = np.cross(in_point - out_point, side)
    return [revolute(side, out_point), revolute(other, out_point), revolute(other, in_point), revolute(side, in_point)]


def hexapods(folder: Path) -> dict[str, Path]:
    """Write machines with six legs."""
    found = {}
    for name, base, top, height, below, above in (
        ("gough", 0.5, 0.25, 0.6, (-15, 15, 105, 135, 225, 255), (-45, 45, 75, 165, 195, 285)),
        ("octahedral", 0.4, 0.2, 0.35, (0, 0.1, 120, 120.1, 240, 240.1), (-60, 60, 60.1, 180, 180.1, 300)),
        ("flat", 0.3, 0.12, 0.2, (-10, 10, 110, 130, 230, 250), (-50, 50, 70, 170, 190, 290)),
    ):
        legs = [strut(b, p) for b, p in zip(ring(base, below), ring(top, above, height), strict=True)]
        found[name] = platform(name, legs, (0, 0, height + 0.05), folder)
    degrees, others = (-15, 15, 105, 135, 225, 255), (-45, 45, 75, 165, 195, 285)
    cranks, sliders = [], []
    for b, p in zip(ring(0.35, degrees), ring(0.15, others, -0.45), strict=True):
        out = b / np.linalg.norm(b)
        elbow = b + 0.15 * (out - 0.5 * Z) / np.linalg.norm(out - 0.5 * Z)
        side = across(p - elbow)
        joints = [revolute(side, elbow), revolute(np.cross(p - elbow, side), elbow), ball(p)]
        cranks.append([revolute(np.cross(Z, out), b, driven=True), *joints])
    for b, p in zip(ring(0.4, degrees, 0.1), ring(0.15, others, 0.5), strict=True):
        side = across(p - b)
        sliders.append([slider(Z, b), revolute(side, b), revolute(np.cross(p - b, side), b), ball(p)])
    found["6-RUS"] = platform("rus6", cranks, (0, 0, -0.5), folder)
    found["6-PUS"] = platform("pus6", sliders, (0, 0, 0.55), folder)
    return found


def tripods(folder: Path) -> dict[str, Path]:
    """Write machines with three legs."""
    planar, space = ("x", "y", "rz"), ("x", "y", "z")
    base, top = ring(0.4, THREE), ring(0.08, (70, 190, 310))
    found = {}
    legs = [[revolute(Z, b), slider(p - b, b), revolute(Z, p)] for b, p in zip(base, top, strict=True)]
    found["3-RPR"] = platform("rpr3", legs, (0.02, 0.01, 0.0), folder, planar)
    legs = []
    for b, p in zip(base, top, strict=True):
        elbow = 0.5 * (b + p) + 0.12 * np.cross(Z, p - b) / np.linalg.norm(p - b)
        legs.append([revolute(Z, b, driven=True), revolute(Z, elbow), revolute(Z, p)])
    found["3-RRR"] = platform("rrr3", legs, (0.0, 0.01, 0.0), folder, planar)
    legs = [
        [slider(np.cross(Z, b), 0.7 * b), revolute(Z, 0.7 * b), revolute(Z, p)] for b, p in zip(base, top, strict=True)
    ]
    found["3-PRR"] = platform("prr3", legs, (0.0, 0.01, 0.0), folder, planar)
    spatial: dict[str, tuple[Callable[[np.ndarray, np.ndarray], list[Joint]], float, tuple[str, ...]]] = {
        "3-PRS": (lambda o, t: [slider(Z, 0.3 * o), revolute(t, 0.3 * o), ball(0.12 * o + 0.35 * Z)], 0.4, ()),
        "3-RPS": (
            lambda o, t: [
                revolute(t, 0.3 * o),
                slider(0.4 * Z - 0.15 * o, 0.2 * Z + 0.225 * o),
                ball(0.15 * o + 0.4 * Z),
            ],
            0.45,
            (),
        ),
        "3-RRS": (
            lambda o, t: [
                revolute(t, 0.2 * o, driven=True),
                revolute(t, 0.32 * o + 0.12 * Z),
                ball(0.15 * o + 0.3 * Z),
            ],
            0.33,
            (),
        ),
        "3-UPU": (
            lambda o, t: [
                *rod(0.35 * o, 0.12 * o + 0.5 * Z, t)[:2],
                slider(0.5 * Z - 0.23 * o, 0.235 * o + 0.25 * Z),
                *rod(0.35 * o, 0.12 * o + 0.5 * Z, t)[2:],
            ],
            0.5,
            space,
        ),
        "3-RUU": (
            lambda o, t: [revolute(t, 0.25 * o, driven=True), *rod(0.4 * o - 0.1 * Z, 0.08 * o - 0.45 * Z, t)],
            -0.45,
            space,
        ),
        "3-PUU": (
            lambda o, t: [slider(Z, 0.3 * o + 0.5 * Z), *rod(0.3 * o + 0.5 * Z, 0.06 * o + 0.1 * Z, t)],
            0.1,
            space,
        ),
    }
    for name, (leg, height, motions) in spatial.items():
        found[name] = platform(name.replace("3-", "n"), three_legs(leg), (0, 0, height), folder, motions)
    arcs = []
    for degrees in THREE:
        turns = [Rotation.from_euler("z", np.radians(degrees) + more) for more in (0.0, 0.9)]
        first, last = (
            turn.apply(v) / np.linalg.norm(v) for turn, v in zip(turns, ([1, 0, -0.8], [1, 0, 0.5]), strict=True)
        )
        middle = np.cross(first, last)
        middle = middle / np.linalg.norm(middle) + 0.3 * (first + last)
        arcs.append([revolute(first, np.zeros(3), driven=True), *(revolute(v, np.zeros(3)) for v in (middle, last))])
    found["spherical 3-RRR"] = platform("spherical", arcs, (0, 0, 0.1), folder, ("rx", "ry", "rz"))
    pivot = 0.3 * Z
    struts = [strut(np.array([-0.08, y, 0.0]), np.array([-0.06, y, 0.28])) for y in (0.06, -0.06)]
    found["wrist 2-UPS + U"] = platform(
        "wrist", [[revolute(X, pivot), revolute(Y, pivot)], *struts], (0, 0, 0.4), folder
    )
    struts = [strut(ring(0.25, [a])[0], ring(0.12, [a + 40], 0.3)[0]) for a in THREE]
    found["3-SPS + S"] = platform("spss", [[revolute(v, pivot) for v in (X, Y, Z)], *struts], (0, 0, 0.4), folder)
    struts = [strut(ring(0.35, [a])[0], ring(0.12, [a], 0.5)[0]) for a in THREE]
    middle = [revolute(X, np.zeros(3)), revolute(Y, np.zeros(3)), slider(Z, pivot, driven=False)]
    found["tricept"] = platform("tricept", [middle, *struts], (0, 0, 0.65), folder)
    return found


def single_loops(folder: Path) -> dict[str, Path]:
    """Write a five-bar, a four-bar, a slider-crank, Bennett's linkage and an RSSR."""
    found = {}
    for name, joints, others, at, motions in (
        (
            "five-bar",
            [revolute(Z, (-0.1, 0, 0), True), revolute(Z, (-0.18, 0.15, 0))],
            [revolute(Z, (0.1, 0, 0), True), revolute(Z, (0.18, 0.15, 0))],
            (0.0, 0.3, 0.0),
            ("x", "y"),
        ),
        (
            "four-bar",
            [revolute(Y, (0, 0, 0), True), revolute(Y, (0, 0, 0.1))],
            [revolute(Y, (0.25, 0, 0))],
            (0.25, 0.0, 0.2),
            ("x", "z"),
        ),
        (
            "slider-crank",
            [revolute(Y, (0, 0, 0), True), revolute(Y, (0.03, 0, 0.05))],
            [slider(X, (0.25, 0, 0), driven=False)],
            (0.25, 0.0, 0.0),
            ("x",),
        ),
        (
            "RSSR",
            [revolute(Z, (0, 0, 0), True), revolute(X, (0.08, 0, 0)), revolute(Z, (0.08, 0, 0))],
            [revolute(X, (0.08, 0.3, -0.12))],
            (0.08, 0.3, 0.0),
            ("y",),
        ),
    ):
        found[name] = _loop(name, joints, others, np.array(at), "3d", folder, motions)
    places = _bennett()
    axes = [revolute(place[:3, 2], place[:3, 3]) for place in places]
    driven = axes[0]._replace(driven=True)
    found["Bennett"] = _loop("bennett", [driven, axes[1]], [axes[3], axes[2]], axes[2].at, "6d", folder, ("x",))
    return found


def _loop(
    name: str,
    first: Sequence[Joint],
    second: Sequence[Joint],
    at: np.ndarray,
    kind: str,
    folder: Path,
    motions: Sequence[str],
) -> Path:
    writer, ends = Writer(name), []
    for label, chain in (("pen", first), ("end", second)):
        link = "base"
        for joint in chain:
            link = writer.joint(link, joint)
        ends.append(writer.fixed(link, label, at))
    writer.closures.append((ends[0], ends[1], kind))
    return writer.save(folder, "pen", motions)


def _bennett() -> list[np.ndarray]:
    """Return the places of its four hinges, with opposite links alike, and lengths as the sines of the twists."""
    twist = np.radians(50.0)
    links = ((0.3, twist), (0.2, float(np.arcsin(0.2 * np.sin(twist) / 0.3)))) * 2

    def places(angles: np.ndarray) -> list[np.ndarray]:
        found = [np.eye(4)]
        for angle, (length, turn) in zip((1.2, *angles), links, strict=True):
            step = np.eye(4)
            step[:3, :3] = (Rotation.from_euler("z", angle) * Rotation.from_euler("x", turn)).as_matrix()
            step[:3, 3] = length * np.array([np.cos(angle), np.sin(angle), 0.0])
            found.append(found[-1] @ step)
        return found

    starts = np.random.default_rng(0).uniform(-3.0, 3.0, (30, 3))
    tried = [scipy.optimize.least_squares(lambda a: (places(a)[4] - np.eye(4)).ravel(), start) for start in starts]
    return places(min(tried, key=lambda each: each.cost).x)[:4]


def arms(folder: Path) -> dict[str, Path]:
    """Write serial arms."""
    found = {}
    swing = (-1.5, 1.5)
    for name, joints, tool, motions in (
        (
            "SCARA",
            [
                (revolute(Z, (0, 0, 0.3), True), (-2.0, 2.0)),
                (revolute(Z, (0.25, 0, 0.3), True), (0.3, 2.0)),
                (slider(Z, (0.45, 0, 0.3)), (-0.06, 0.06)),
                (revolute(Z, (0.45, 0, 0.2), True), (-2.0, 2.0)),
            ],
            (0.45, 0, 0.1),
            ("x", "y", "z", "rz"),
        ),
        (
            "6R",
            [
                (revolute(axis, at, True), swing)
                for axis, at in zip(
                    (Z, Y, Y, X, Y, X),
                    ((0, 0, 0.4), (0.1, 0, 0.4), (0.1, 0, 0.9), (0.3, 0, 0.95), (0.6, 0, 0.95), (0.65, 0, 0.95)),
                    strict=True,
                )
            ],
            (0.8, 0, 0.93),
            (),
        ),
        ("cartesian", [(slider(axis, 0.1 * k * Z), (-0.2, 0.2)) for k, axis in enumerate((X, Y, Z))], (0.05, 0, 0), ()),
    ):
        writer, link = Writer(name), "base"
        for joint, limits in joints:
            link = writer.joint(link, joint, limits)
        found[name] = writer.save(folder, writer.fixed(link, "tool", tool), motions)
    return found


def robots(folder: Path) -> dict[str, Path]:
    """Write all of them to a folder; return their paths by name."""
    return {**tripods(folder), **hexapods(folder), **single_loops(folder), **arms(folder)}
