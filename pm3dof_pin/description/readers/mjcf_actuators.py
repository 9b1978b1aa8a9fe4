"""Actuators and tendons of MJCF: drives, commands and springs."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from pm3dof_pin.description.coordinates import Command
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import WORLD, Body, Drive, Joint
from pm3dof_pin.description.physical_bounds import ANY
from pm3dof_pin.description.readers.control_laws import BIASES, LAGS, with_control_law
from pm3dof_pin.description.readers.elements import free_name, named
from pm3dof_pin.description.readers.mjcf_elements import STIFFNESS
from pm3dof_pin.description.readers.mjcf_tree import MjcfTree
from pm3dof_pin.description.xml_file import Element
from pm3dof_pin.exceptions import JointNotFoundError

_logger = logging.getLogger(__name__)


class MjcfActuators:
    """Reads the actuators and tendons of a model.

    A tendon over several joints becomes a coordinate that is coupled to them.

    Args:
        tree: its bodies, joints and sites.
        couplings: its couplings.
    """

    def __init__(self, tree: MjcfTree, couplings: Sequence[Coupling]) -> None:
        self._tree, self._couplings = tree, couplings
        self.bodies: list[Body] = []  #: of tendons over several joints
        self.joints: list[Joint] = []  #: their coordinates
        self.couplings: list[Coupling] = []  #: of these with the joints

    def drives(self) -> tuple[Drive, ...]:
        """Return the drives; JointNotFoundError if one refers to an unknown joint."""
        tendons = {tendon.get("name", ""): tendon for tendon in self._tree.document.sections("tendon")}
        drives: list[Drive] = []
        known = {joint.name: joint for joint in self._tree.joints}
        for given in self._tree.document.sections("actuator"):
            element = self._tree.resolved(given, "", kind="actuator")
            joint_name = element.get("joint") or element.get("jointinparent")
            gear = (*self._tree.numbers(element, "gear", None, ANY, named(given), (1.0,)), 1.0)[0]
            if "tendon" in element.attrib:
                tendon = tendons.get(element.attrib["tendon"])
                if tendon is None or tendon.tag != "fixed":
                    self._tree.refuse(given, f"expected a fixed tendon, not '{element.attrib['tendon']}'")
                    continue
                joint_name, share = self._tendon_joint(tendon)
                gear *= share
            elif "slidersite" in element.attrib or "cranksite" in element.attrib:
                self._tree.refuse(given, "slider-crank transmissions are not supported")
                continue
            if joint_name is None:
                name = f" '{given.get('name')}'" if "name" in given.attrib else ""
                _logger.warning("%s: actuator%s drives no joint and is ignored", self._tree.path, name)
                self._tree.read_over(given, "drives no joint")
                continue
            names = [*known, *(joint.name for joint in self.joints)]
            if joint_name not in names:
                raise JointNotFoundError(joint_name, f"{given.origin}: <actuator>", names)
            if joint_name in known and not known[joint_name].is_single:
                message = "%s: actuator '%s' drives a ball or free joint and is ignored"
                _logger.warning(message, self._tree.path, given.get("name", joint_name))
                self._tree.read_over(given, "drives a ball or free joint")
                continue
            drives.append(self._drive(element, given, joint_name, gear))
        return tuple(drives)

    def _drive(self, element: Element, given: Element, joint: str, gear: float) -> Drive:
        place = named(given)
        ranges = {}
        for key in ("ctrl", "force"):
            lower, upper = self._tree.limits(element, f"{key}range", place, 1.0)
            given_range = (
                lower is not None and upper is not None and self._tree.is_limited(element, given, f"{key}limited")
            )
            ranges[key] = (lower, upper) if given_range and lower is not None and upper is not None else None
        is_servo = given.tag in ("position", "intvelocity")
        default_gain = 1.0 if is_servo else None
        drive = Drive(
            given.get("name", joint),
            joint,
            gear,
            kind=given.tag,
            proportional_gain=self._tree.number(element, "kp", ANY, place, default_gain) if is_servo else None,
            derivative_gain=self._tree.number(element, "kv", ANY, place, 1.0 if given.tag == "velocity" else None),
            control_range=ranges["ctrl"],
            force_range=ranges["force"],
            origin=given.origin,
        )
        kinds = {"gaintype": ("fixed",), "biastype": BIASES, "dyntype": LAGS}  # the first is the default
        if given.tag != "general" or any(element.get(key, known[0]) not in known for key, known in kinds.items()):
            return drive
        gain = (*self._tree.numbers(element, "gainprm", None, ANY, place, (1.0,)), 0.0)[0]
        bias = (*self._tree.numbers(element, "biasprm", None, ANY, place, ()), 0.0, 0.0, 0.0)[:3]
        return with_control_law(drive, gain, bias if element.get("biastype") == "affine" else (0.0, 0.0, 0.0))

    def _tendon_joint(self, tendon: Element) -> tuple[str, float]:
        """Return the joint that stands for a fixed tendon, and the tendon's length per unit of its coordinate."""
        place = named(tendon)
        factors = self._tree.tendon_factors(tendon)
        followed = {c.joint: c for c in self._couplings if c.is_linear and len(c.joints) == 1}
        shares: dict[str, float] = {}
        for name, factor in factors.items():
            if name in followed:
                name, factor = followed[name].joints[0], factor * followed[name].coefficients[0][0]
            shares[name] = shares.get(name, 0.0) + factor
        if len(shares) == 1:
            return next(iter(shares.items()))
        if not shares:
            raise tendon.origin.error(place, "has no joints, expected some")
        name = free_name(tendon.get("name") or "tendon", [joint.name for joint in self._tree.joints])
        if name not in [joint.name for joint in self.joints]:
            body = free_name(f"{name}_length", self._tree.taken)
            self.bodies.append(Body(body, origin=tendon.origin))
            self.joints.append(Joint(name, "prismatic", WORLD, body, origin=tendon.origin))
            powers = tuple((factor,) for factor in factors.values())
            self.couplings.append(Coupling(name, tuple(factors), powers, origin=tendon.origin))
        return name, 1.0

    def commands(self, drives: tuple[Drive, ...]) -> tuple[Command, ...]:
        """Return a command for each driven joint, named after its first actuator: the joint's coordinate."""
        slides = {joint.name for joint in self._tree.joints if joint.type != "prismatic"}
        first: dict[str, str] = {}
        for drive in drives:
            first.setdefault(drive.joint, drive.name)
        return tuple(Command(name, joint, "rad" if joint in slides else "m") for joint, name in first.items())

    def springs(self) -> tuple[dict[str, object], ...]:
        """Return the springs of joints and of fixed tendons; parts of tendons over several joints are added."""
        named_stiffness = {
            joint.name: (joint.name, joint.stiffness) for joint in self._tree.joints if joint.stiffness > 0.0
        }
        for given in self._tree.document.sections("tendon"):
            element = self._tree.resolved(given, "", kind="tendon")
            stiffness = (*self._tree.numbers(element, "stiffness", None, STIFFNESS, named(given), (0.0,)), 0.0)[0]
            if stiffness > 0.0 and given.tag == "fixed":
                joint, share = self._tendon_joint(given)
                name, own = named_stiffness.get(joint, (given.get("name") or joint, 0.0))
                named_stiffness[joint] = (name, own + stiffness * share**2)
            elif stiffness > 0.0:
                self._tree.read_over(given, "the stiffness of a spatial tendon")
        turning = {joint.name for joint in self._tree.joints if joint.type != "prismatic"}
        return tuple(
            {
                "name": name,
                "type": "joint",
                "joint": joint,
                "stiffness": stiffness,
                "unit": "N m/rad" if joint in turning else "N/m",
            }
            for joint, (name, stiffness) in named_stiffness.items()
        )
