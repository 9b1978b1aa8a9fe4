"""URDF and SRDF files read into a Pinocchio model, without terminal output, with errors that name the place."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.physical_bounds import ANY, parse_numbers
from pm3dof_pin.description.urdf_checks import check_urdf
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.mechanism.joint_types import with_joint_types
from pm3dof_pin.mechanism.parser_messages import parser_messages

UNLIMITED = sys.float_info.max
"""Pinocchio's limit of an unlimited coordinate."""

_logger = logging.getLogger(__name__)


def read_model(urdf: Path, *, joint_types: Mapping[str, str] | None = None, source: Path | str = "") -> pin.Model:
    """Read the tree of a URDF, replacing joints as :func:`with_joint_types`; joints without limits are unlimited.

    Raises:
        DescriptionError: the file is unreadable, not XML (with the line), not a URDF or physically impossible (see
            :func:`~pm3dof_pin.description.urdf_checks.check_urdf`), or a joint type is unknown.
        JointNotFoundError: a joint to be replaced does not exist.
    """
    root = read_xml(urdf)
    if impossible := check_urdf(root, urdf):
        link, problem = next(iter(impossible.items()))
        others = f"; likewise {len(impossible) - 1} more links" if len(impossible) > 1 else ""
        _logger.warning(
            "%s: link '%s': inertial: %s%s; dynamics is not available if it moves", urdf, link, problem, others
        )
    _complete_limits(root)
    try:
        with parser_messages() as complaints:
            model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        reason = complaints[0].removeprefix("Error:").strip() if complaints else str(error)
        raise DescriptionError(urdf, "URDF", f"expected a robot that urdfdom accepts ({reason})") from error
    for line in complaints:
        _logger.warning("%s: %s", urdf, line)
    if mimicking := [joint.get("name", "") for joint in root.findall("joint") if joint.find("mimic") is not None]:
        _logger.warning("%s: <mimic> is ignored; treated as independent: %s", urdf, ", ".join(mimicking))
    return with_joint_types(model, joint_types, source) if joint_types else model


def _complete_limits(root: ElementTree.Element) -> None:
    """Make joints without limits unlimited, in the only form that urdfdom accepts."""
    for joint in root.findall("joint"):
        if joint.get("type") in ("revolute", "prismatic"):
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit")
            missing = {"effort": "0", "velocity": "0"}
            if "lower" not in limit.attrib and "upper" not in limit.attrib:
                missing |= {"lower": repr(-UNLIMITED), "upper": repr(UNLIMITED)}
            for key, value in missing.items():
                limit.attrib.setdefault(key, value)


def read_named_configurations(model: pin.Model, srdf: Path) -> None:
    """Read the named configurations (`group_state`) of an SRDF into `model.referenceConfigurations`.

    Joints that are not named stay neutral. Joints that the model does not have, such as a floating base that is fixed
    here, are ignored with a warning.

    Raises:
        DescriptionError: the file is unreadable, is not XML, or gives a joint the wrong number of values.
    """
    for state in read_xml(srdf).iter("group_state"):
        q = pin.neutral(model)
        element = f"group_state '{state.get('name')}'"
        for joint in state.iter("joint"):
            name = joint.get("name", "")
            if not model.existJointName(name):
                _logger.warning("%s: %s: no joint '%s' in the model: ignored", srdf, element, name)
                continue
            values, problem = parse_numbers(joint.get("value", ""), ANY)
            index = model.joints[model.getJointId(name)]
            positions = slice(index.idx_q, index.idx_q + index.nq)
            if len(values) == 1 and index.nq == 2 and index.nv == 1 and not problem:
                values = (float(np.cos(values[0])), float(np.sin(values[0])))
            if not problem and len(values) != index.nq:
                problem = f"expected a value of {index.nq} number(s), not '{joint.get('value', '')}'"
            if problem:
                raise DescriptionError(srdf, f"{element}: joint '{name}'", problem)
            q[positions] = values
        q = pin.normalize(model, q)
        if not np.isfinite(q).all():
            raise DescriptionError(srdf, element, "expected nonzero quaternions and cosine-sine pairs")
        model.referenceConfigurations[str(state.get("name"))] = q
