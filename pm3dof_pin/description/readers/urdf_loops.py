"""Elements that others have added to URDF, a tree, to close loops and couple joints.

- URDF+ (Chignoli et al., arXiv 2411.19753): `<loop>`, its axis in the frames that its two origins place; `<coupling>`,
  by which the ratio times the joints on the way to the predecessor is the sum of those to the successor; and joints
  that are `independent`, which are taken as actuated if no transmission says otherwise.
- `<constraint>` as proposed in ros/urdfdom#264, with an axis in each of its two frames, and `<loop_constraint>`.
- `<loop_joint>` of Isaac Sim and of Drake's early versions.
- Drake's `<drake:ball_constraint>`, `<drake:distance_constraint>` and `<drake:tendon_constraint>` of equal limits.
- In `<gazebo>`, a `<joint>` of SDF between two links of the tree, and plugins that make a joint mimic another.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closure_types import CLOSURE_TYPE_NAMES, CLOSURE_TYPES, ClosureTypeName
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import Description, Frame, Placement
from pm3dof_pin.description.physical_bounds import ANGLE, ANY, LENGTH
from pm3dof_pin.description.readers.drake_constraints import (
    POINT_CONSTRAINTS,
    TENDON_CONSTRAINT,
    point_constraint,
    tendon_coupling,
)
from pm3dof_pin.description.readers.elements import free_name, named
from pm3dof_pin.description.readers.gearbox import gearbox_coupling
from pm3dof_pin.description.xml_file import Element, child, children
from pm3dof_pin.exceptions import InvalidValueError

if TYPE_CHECKING:
    from pm3dof_pin.description.readers.urdf import UrdfReader

_REFUSED = ("drake:linear_bushing_rpy", "drake:weld_constraint")
LOOP_TAGS = (
    *("loop", "coupling", "constraint", "loop_constraint", "loop_joint", *POINT_CONSTRAINTS, TENDON_CONSTRAINT),
    *_REFUSED,
)
"""Elements of `<robot>` that are read, or refused, here."""

_REFERENCE = "gearbox_reference_body"
_Z = (0.0, 0.0, 1.0)
_TYPES: dict[str, ClosureTypeName] = {"continuous": "hinge", **CLOSURE_TYPE_NAMES}


class UrdfLoops:
    """Completes the description of a tree by its loops and couplings."""

    def __init__(self, reader: UrdfReader, tree: Description) -> None:
        self.reader = reader
        self.tree = tree
        self.frames: list[Frame] = []
        self.closures: list[LoopClosure] = []
        self.couplings = list(tree.couplings)
        self.names = {*tree.body_by_name, *tree.joint_by_name}

    def read(self, root: Element) -> Description:
        """Read the elements of the root, in the order of the file."""
        independent = self._independent(root)
        for element in children(root):
            match element.tag:
                case "loop":
                    self._loop(element, "predecessor", "successor")
                case "constraint" | "loop_constraint":
                    self._constraint(element)
                case "loop_joint":
                    self._loop_joint(element)
                case tag if tag in POINT_CONSTRAINTS:
                    found = point_constraint(self.reader, element)
                    ends = list(zip(found.bodies, found.points, strict=True))
                    self._close(element, ends, None, None, found.kind, found.length)
                case tag if tag == TENDON_CONSTRAINT:
                    followed = {coupling.joint for coupling in self.couplings}
                    leading = {*independent, *(drive.joint for drive in self.tree.drives)}
                    coupling = tendon_coupling(self.reader, element, self.tree.joint_by_name, leading, followed)
                    self.couplings += [coupling] if coupling is not None else []
                case "coupling":
                    self._coupling(element, independent)
                case "gazebo":
                    self._gazebo(element)
                case tag if tag in _REFUSED:
                    self.reader.refuse(element, "is not supported")
        is_closed = bool(self.closures or self.couplings)
        driven = tuple(drive.joint for drive in self.tree.drives) or tuple(independent)
        return replace(
            self.tree,
            frames=tuple(self.frames),
            closures=tuple(self.closures),
            couplings=tuple(self.couplings),
            actuated_joints=tuple(dict.fromkeys(driven)) if is_closed or independent else (),
        )

    def _independent(self, root: Element) -> list[str]:
        """Return the joints of URDF+ that are independent, which is the default in a file with any that are not."""
        joints = [
            joint for joint in children(root, "joint") if self.tree.joint_by_name[joint.get("name", "")].is_single
        ]
        if not any("independent" in joint.attrib for joint in joints):
            return []
        return [joint.get("name", "") for joint in joints if joint.get("independent", "true").lower() == "true"]

    def _loop(self, element: Element, first: str, second: str) -> None:
        ends = [child(element, tag) for tag in (first, second)]
        frames = []
        for tag, end in zip((first, second), ends, strict=True):
            if end is None:
                raise element.origin.error(named(element), f"expected <{tag}> in it")
            frames.append((end.get("link", ""), self.reader.placement(end, f"{named(element)}: {tag}")))
        self._close(element, frames, self._axis(element, "axis"), None)

    def _constraint(self, element: Element) -> None:
        frames = []
        for tag in ("parent", "child"):
            end = child(element, tag)
            link = "" if end is None else end.get("link", "")
            frames.append((link, self.reader.placement(element, named(element), f"{tag}_origin")))
        self._close(
            element, frames, self._axis(element, "parent_axis", "axis"), self._axis(element, "child_axis"), "3d"
        )

    def _loop_joint(self, element: Element) -> None:
        ends = children(element, "link1", "link2")  # or two <link1>, as in Isaac Sim's manual
        if len(ends) != 2:
            raise element.origin.error(named(element), "expected <link1> and <link2> in it")
        zero = (0.0, 0.0, 0.0)
        frames = []
        for end in ends:
            place = f"{named(element)}: {end.tag}"
            position = self.reader.numbers(end, "xyz", 3, LENGTH, place, zero)
            angles = self.reader.numbers(end, "rpy", 3, ANGLE, place, zero)
            frames.append((end.get("link", ""), Placement.from_angles(position, angles)))
        self._close(element, frames, self._axis(element, "axis"), None)

    def _axis(self, element: Element, *tags: str) -> tuple[float, ...] | None:
        tag = next((tag for tag in tags if child(element, tag) is not None), None)
        return None if tag is None else self.reader.axis(element, named(element), tag)

    def _close(
        self,
        element: Element,
        ends: list[tuple[str, Placement]],
        axis: tuple[float, ...] | None,
        other_axis: tuple[float, ...] | None,
        default_type: str = "",
        length: float | None = None,
    ) -> None:
        """Add a closure between two frames, each given by its link and its placement in it."""
        given = element.get("type", default_type).lower()
        if (kind := _TYPES.get(given)) is None:
            self.reader.refuse(element, f"expected a type of {', '.join(CLOSURE_TYPES)}, not '{given}'")
            return
        name = element.get("name") or f"{element.tag.partition(':')[2] or element.tag}{len(self.closures) + 1}"
        frames: list[str] = []
        for (link, placement), end in zip(ends, "ab", strict=True):
            if link not in self.tree.body_by_name:
                raise element.origin.error(named(element), f"expected an existing link, not '{link}'")
            frames.append(self._frame(f"{name}_{end}", link, placement, element))
        row = CLOSURE_TYPES[kind]
        if row.axis is None:
            axis = other_axis = None
        elif axis is None:
            axis = (1.0, 0.0, 0.0)
        axes = (_triple(axis), _triple(other_axis) if row.has_two_axes else None)
        try:
            closure = LoopClosure(
                frames[0], frames[1], kind, axis=axes[0], axis_b=axes[1], length=length, origin=element.origin
            )
        except InvalidValueError as error:
            raise element.origin.error(named(element), str(error)) from error
        self.closures.append(closure)

    def _frame(self, name: str, link: str, placement: Placement, element: Element) -> str:
        if placement.is_identity:
            return link
        name = free_name(name, self.names)
        self.names.add(name)
        self.frames.append(Frame(name, link, placement, element.origin))
        return name

    def _coupling(self, element: Element, independent: list[str]) -> None:
        place = named(element)
        links = [end.get("link", "") for tag in ("predecessor", "successor") for end in children(element, tag)]
        if len(links) != 2 or not set(links) <= self.tree.body_by_name.keys():
            raise element.origin.error(place, "expected an existing link in <predecessor> and in <successor>")
        ratio = self.reader.number(child(element, "ratio"), "value", ANY, f"{place}: ratio", 1.0)
        before, after = ([joint.name for joint in self.tree.joints_to(link) if not joint.is_fixed] for link in links)
        shared = set(before) & set(after)
        factors = {name: ratio for name in before if name not in shared}
        factors |= {name: -1.0 for name in after if name not in shared}
        followed = {coupling.joint for coupling in self.couplings}
        candidates = [name for name in reversed(factors) if name not in followed and factors[name]]
        joint = next((name for name in candidates if name not in independent), next(iter(candidates), ""))
        others = [name for name in factors if name != joint]
        if not joint or not others or not all(self.tree.joint_by_name[name].is_single for name in factors):
            self.reader.refuse(element, "expected single-DoF joints that are not coupled otherwise")
            return
        powers = tuple((-factors[name] / factors[joint],) for name in others)
        self.couplings.append(Coupling(joint, tuple(others), powers, origin=element.origin))

    def _gazebo(self, element: Element) -> None:
        joints = children(element, "joint")
        plugins = [plugin for plugin in children(element, "plugin") if child(plugin, "mimicJoint") is not None]
        for joint in joints:
            self._gazebo_joint(joint)
        for plugin in plugins:
            texts = {part.tag: (part.text or "").strip() for part in children(plugin)}
            # the mimic joint follows the joint
            name, other = texts["mimicJoint"], texts.get("joint", "")
            for key, text in texts.items():
                plugin.set(key, text)
            powers = (
                self.reader.number(plugin, "offset", ANY, named(plugin), 0.0),
                self.reader.number(plugin, "multiplier", ANY, named(plugin), 1.0),
            )
            if not {name, other} <= self.tree.joint_by_name.keys():
                self.reader.refuse(plugin, f"expected existing joints, not '{other}' and '{name}'")
            elif not self.tree.joint_by_name[name].is_single:
                self.reader.read_over(plugin, f"joint '{name}' is {self.tree.joint_by_name[name].type}")
            elif all(coupling.joint != name for coupling in self.couplings):  # usually <mimic> says the same
                self.couplings.append(Coupling.from_powers(name, other, powers, plugin.origin))
        if not joints and not plugins:
            self.reader.read_over(element)

    def _gazebo_joint(self, element: Element) -> None:
        """Read a joint of SDF: its frame is placed in the child unless it says otherwise, and the axis given in it."""
        links = []
        for tag in ("parent", "child", _REFERENCE):
            part = child(element, tag)
            link = "" if part is None else (part.text or "").strip()
            if link != "world" and link not in self.tree.body_by_name and (part is not None or tag != _REFERENCE):
                raise element.origin.error(named(element), f"expected an existing link, not '{link}'")
            links.append(self.tree.root.name if link == "world" and link not in self.tree.body_by_name else link)
        pose = child(element, "pose")
        reference = ("" if pose is None else pose.get("relative_to", "")) or links[1]
        if pose is not None and (pose.text or "").strip():
            element.set("pose", (pose.text or "").strip())
        numbers = self.reader.numbers(element, "pose", 6, ANY, named(element), (0.0,) * 6)
        placed = self._zero_placement(reference, element) * Placement.from_angles(numbers[:3], numbers[3:]).se3
        axes = [self._gazebo_axis(element, tag, placed) for tag in ("axis", "axis2")]
        if element.get("type") == "gearbox":
            in_root = [placed.rotation @ axis for axis in (axes[0] or _Z, axes[1] or axes[0] or _Z)]
            ratio = child(element, "gearbox_ratio")
            element.set("ratio", "1" if ratio is None else (ratio.text or "").strip())
            number = self.reader.number(element, "ratio", ANY, named(element), 1.0)
            coupling = gearbox_coupling(self.tree, links[:2], links[2], in_root, number, element.origin)
            if isinstance(coupling, str):
                self.reader.refuse(element, coupling)
            elif all(coupling.joint != other.joint for other in self.couplings):  # usually <mimic> says the same
                self.couplings.append(coupling)
            return
        if element.get("type") == "universal":
            axes[0], axes[1] = axes[0] or (1.0, 0.0, 0.0), axes[1] or (0.0, 1.0, 0.0)
        else:
            axes = [axes[0] or _Z, None]
        ends = [
            (link, Placement.from_se3(self.tree.zero_placements[link].actInv(placed)) if link != reference else None)
            for link in links[:2]
        ]
        given = Placement.from_angles(numbers[:3], numbers[3:])  # without rounding
        self._close(element, [(link, placement or given) for link, placement in ends], axes[0], axes[1])

    def _zero_placement(self, name: str, element: Element) -> pin.SE3:
        """Return the placement of a link, a joint or the model in the root, at zero."""
        if name in self.tree.joint_by_name and name not in self.tree.body_by_name:
            name = self.tree.joint_by_name[name].child
        name = self.tree.root.name if name in ("__model__", "world") else name
        if name not in self.tree.body_by_name:
            raise element.origin.error(named(element), f"expected an existing frame, not '{name}'")
        return self.tree.zero_placements[name]

    def _gazebo_axis(self, element: Element, tag: str, placed: pin.SE3) -> tuple[float, ...] | None:
        """Return an axis of a joint of SDF in the joint's frame."""
        axis = child(element, tag)
        xyz = child(axis, "xyz")
        if xyz is None:
            return None
        element.set(tag, (xyz.text or "").strip())
        numbers = self.reader.numbers(element, tag, 3, ANY, named(element))
        of_model = child(axis, "use_parent_model_frame")
        is_of_model = of_model is not None and (of_model.text or "").strip() in ("true", "1")
        frame = "__model__" if is_of_model else xyz.get("expressed_in", "")
        if not frame:
            return numbers
        return tuple((placed.rotation.T @ self._zero_placement(frame, element).rotation @ numbers).tolist())


def _triple(axis: tuple[float, ...] | None) -> tuple[float, float, float] | None:
    if axis is None:
        return None
    x, y, z = (np.array(axis) / np.linalg.norm(axis)).tolist()
    return x, y, z
