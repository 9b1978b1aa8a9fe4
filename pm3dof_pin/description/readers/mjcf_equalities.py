"""Equalities of MJCF: loop closures, couplings of joints, and joints that are held."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.couplings import Coupling, polynomial_of_difference
from pm3dof_pin.description.description import WORLD, Frame, Placement
from pm3dof_pin.description.physical_bounds import ANY, LENGTH
from pm3dof_pin.description.readers.elements import free_name, named
from pm3dof_pin.description.readers.mjcf_tree import MjcfTree
from pm3dof_pin.description.xml_file import Element, children
from pm3dof_pin.exceptions import FrameNotFoundError, InvalidValueError


class MjcfEqualities:
    """Reads the equalities of a model.

    Args:
        tree: its bodies, joints and sites, to which frames of closures are added.
    """

    def __init__(self, tree: MjcfTree) -> None:
        self._tree = tree

    def closures(self) -> tuple[LoopClosure, ...]:
        """Return the loop closures; FrameNotFoundError if one refers to an unknown body."""
        closures = []
        for index, given in enumerate(self._tree.document.sections("equality")):
            element = self._tree.resolved(given, "", kind="equality")
            if given.tag == "joint" or not self._is_active(element, given):
                continue
            if given.tag == "tendon":
                tendon, excess = self._held_tendon(element, given)
                if tendon is not None and tendon.tag == "spatial":
                    closures += self._distance(tendon, given, excess)
                continue
            if given.tag not in ("connect", "weld"):
                self._tree.refuse(given, "is not supported")
                continue
            name = given.get("name") or f"{given.tag}{index + 1}"
            place = f"<{given.tag} name='{name}'>"
            holds_turn = given.tag == "weld" and self._tree.number(element, "torquescale", ANY, place, 1.0) != 0.0
            if "site1" in element.attrib:
                frames = tuple(self._tree.sites.get(element.get(key, ""), "") for key in ("site1", "site2"))
                if not all(frames):
                    raise given.origin.error(place, "expected existing sites")
            else:
                frames = self._closure_frames(element, given, name, place)
            if self._carrier(frames[0]) == self._carrier(frames[1]):
                self._tree.read_over(given, "joins bodies that do not move to each other")
                continue
            closures.append(LoopClosure(frames[0], frames[1], "6d" if holds_turn else "3d", origin=given.origin))
        return tuple(closures)

    def _carrier(self, frame: str) -> str:
        """Return the body that moves a frame: none of those above it moves to it."""
        above = {joint.child: joint for joint in self._tree.joints}
        body = self._tree.frames[frame].body
        while body in above and above[body].is_fixed:
            body = above[body].parent
        return body

    def _closure_frames(self, element: Element, given: Element, name: str, place: str) -> tuple[str, str]:
        """Add the frames at which an equality holds two bodies, by default as they are initially."""
        bodies = [element.get(key, WORLD) for key in ("body1", "body2")]
        for body in bodies:
            if body not in self._tree.bodies:
                raise FrameNotFoundError(body, f"{given.origin}: {place}", list(self._tree.bodies))
        first, second = (self._tree.initial[body] for body in bodies)
        between = first.actInv(second)
        anchor = pin.SE3(np.eye(3), np.array(self._tree.numbers(element, "anchor", 3, LENGTH, place, (0.0, 0.0, 0.0))))
        relative = self._tree.numbers(element, "relpose", 7, ANY, place, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        if given.tag == "connect":
            placements = anchor, between.actInv(anchor)
        elif any(relative[3:]):
            placements = Placement.from_quaternion(relative[:3], relative[3:]).se3, anchor
        else:
            placements = between * anchor, anchor
        names = []
        for body, placement in zip(bodies, placements, strict=True):
            frame = free_name(f"{name}_{body}", {*self._tree.taken, *self._tree.frames})
            self._tree.frames[frame] = Frame(frame, body, Placement.from_se3(placement), given.origin)
            names.append(frame)
        return names[0], names[1]

    def _held_tendon(self, element: Element, given: Element) -> tuple[Element | None, float]:
        """Return the tendon that an equality holds, None if it is not read, and its length beyond the initial one."""
        place = named(given)
        tendons = {tendon.get("name", ""): tendon for tendon in self._tree.document.sections("tendon")}
        tendon = tendons.get(element.get("tendon1", ""))
        if tendon is None:
            raise given.origin.error(place, f"expected an existing tendon, not '{element.get('tendon1', '')}'")
        if element.get("tendon2"):
            self._tree.refuse(given, "is not supported: of two tendons")
            return None, 0.0
        return tendon, self._tree.numbers(element, "polycoef", None, ANY, place, (0.0,))[0]

    def _distance(self, tendon: Element, given: Element, excess: float) -> list[LoopClosure]:
        """Return the closure by which a straight tendon between two sites keeps its length; none for others."""
        frames = [self._tree.sites.get(entry.get("site", ""), "") for entry in children(tendon, "site")]
        if len(frames) != len(children(tendon)) or len(frames) != 2 or not all(frames):
            self._tree.refuse(tendon, "is held by an equality, expected two existing sites and nothing else")
            return []
        ends = [
            self._tree.initial[self._tree.frames[name].body] * self._tree.frames[name].placement.se3 for name in frames
        ]
        length = float(np.linalg.norm(ends[1].translation - ends[0].translation)) + excess
        try:
            return [LoopClosure(frames[0], frames[1], "distance", length=length, origin=given.origin)]
        except InvalidValueError as error:
            raise given.origin.error(named(given), f"expected a positive length, not {length:g}") from error

    def _fixed_tendon(self, tendon: Element, excess: float, zeros: dict[str, float]) -> Coupling | tuple[str, float]:
        """Return the coupling by which a fixed tendon keeps its length; of one joint, its name and coordinate."""
        place = named(tendon)
        factors = self._tree.tendon_factors(tendon)
        follower = next((name for name, factor in factors.items() if factor != 0.0), None)
        if follower is None:
            raise tendon.origin.error(place, "has no joints, expected some")
        share = factors.pop(follower)
        offset = excess / share + zeros[follower]
        others = {name: -factor / share for name, factor in factors.items() if factor != 0.0}
        if not others:
            return follower, offset
        offset -= sum(ratio * zeros[name] for name, ratio in others.items())
        ratios = tuple((ratio,) for ratio in others.values())
        return Coupling(follower, tuple(others), ratios, offset, tendon.origin)

    def _is_active(self, element: Element, given: Element) -> bool:
        if element.get("active") == "false":
            self._tree.read_over(given, "is not active")
            return False
        return True

    def couplings(self) -> tuple[list[Coupling], dict[str, float]]:
        """Return the couplings of joints, and the coordinates at which equalities hold joints."""
        couplings: list[Coupling] = []
        held: dict[str, float] = {}
        zeros = {joint.name: joint.zero for joint in self._tree.joints}
        for given in self._tree.document.sections("equality"):
            if given.tag not in ("joint", "tendon"):
                continue
            element = self._tree.resolved(given, "", kind="equality")
            if not self._is_active(element, given):
                continue
            place = named(given)
            if given.tag == "tendon":
                tendon, excess = self._held_tendon(element, given)
                if tendon is not None and tendon.tag == "fixed":
                    found = self._fixed_tendon(tendon, excess, zeros)
                    if isinstance(found, Coupling):
                        couplings.append(found)
                    else:
                        held[found[0]] = found[1]
                continue
            powers = self._tree.numbers(element, "polycoef", None, ANY, place, (0.0, 1.0, 0.0, 0.0, 0.0))
            powers = (*powers, *(0.0,) * (5 - len(powers)))[:5]
            names = [element.get(key, "") for key in ("joint1", "joint2")]
            for name in names if names[1] else names[:1]:
                self._tree.require_single(name, f"{given.origin}: {place}")
            if names[1]:
                shifted = polynomial_of_difference(powers, zeros[names[1]])
                shifted[0] += zeros[names[0]]
                couplings.append(Coupling.from_powers(names[0], names[1], shifted, given.origin))
            else:
                held[names[0]] = zeros[names[0]] + powers[0]
        return self._without_held(couplings, held), held

    @staticmethod
    def _without_held(couplings: list[Coupling], held: dict[str, float]) -> list[Coupling]:
        """Return the couplings without joints that are held; joints that follow only such ones are held too."""
        pending, left = list(couplings), list[Coupling]()
        while pending:
            coupling = pending.pop(0)
            free = [name for name in coupling.joints if name not in held]
            if len(free) == len(coupling.joints):
                left.append(coupling)
                continue
            offset = coupling.value([held.get(name, 0.0) for name in coupling.joints])
            if free:
                powers = dict(zip(coupling.joints, coupling.coefficients, strict=True))
                coefficients = tuple(powers[name] for name in free)
                left.append(Coupling(coupling.joint, tuple(free), coefficients, offset, coupling.origin))
            elif coupling.joint not in held:
                held[coupling.joint] = offset
                pending, left = [*left, *pending], []
        return left
