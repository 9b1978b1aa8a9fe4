"""URDF and SRDF files read into a Pinocchio model: silent on the terminal, with errors that name the place."""

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
"""Pinocchio's limit of a coordinate that has none."""

_logger = logging.getLogger(__name__)


def read_model(urdf: Path, *, joint_types: Mapping[str, str] | None = None, source: Path | str = "") -> pin.Model:
    """Read the tree of a URDF, its joints without limits unlimited, some replaced as :func:`with_joint_types` does.

    Raises:
        DescriptionError: the file is unreadable, not XML (with the line), not a URDF or physically impossible (see
            :func:`~pm3dof_pin.description.urdf_checks.check_urdf`), or a type of joint is unknown.
        JointNotFoundError: a joint to be replaced is not there.
    """
    root = read_xml(urdf)
    if impossible := check_urdf(root, urdf):
        link, problem = next(iter(impossible.items()))
        others = f"; so {len(impossible) - 1} more links" if len(impossible) > 1 else ""
        _logger.warning("%s: link '%s': inertial: %s%s: no equations of motion", urdf, link, problem, others)
    _complete_limits(root)
    try:
        with parser_messages() as complaints:
            model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        reason = complaints[0].removeprefix("Error:").strip() if complaints else str(error)
        raise DescriptionError(urdf, "URDF", f"expected a robot that urdfdom accepts ({reason})") from error
    for line in complaints:
        _logger.warning("%s: %s", urdf, line)
    if root.find("joint/mimic") is not None:
        _logger.warning("%s: <mimic> is ignored, these joints are taken as joints of their own", urdf)
    return with_joint_types(model, joint_types, source) if joint_types else model


def _complete_limits(root: ElementTree.Element) -> None:
    """Make joints without limits unlimited, which urdfdom has no other word for."""
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
    here, are passed over with a warning.

    Raises:
        DescriptionError: the file is unreadable, is not XML, or gives a joint no number, or not as many as it takes.
    """
    for state in read_xml(srdf).iter("group_state"):
        q = pin.neutral(model)
        element = f"group_state '{state.get('name')}'"
        for joint in state.iter("joint"):
            name = joint.get("name", "")
            if not model.existJointName(name):
                _logger.warning("%s: %s: no joint '%s' in the model: it is passed over", srdf, element, name)
                continue
            values, problem = parse_numbers(joint.get("value", ""), ANY)
            index = model.joints[model.getJointId(name)]
            positions = slice(index.idx_q, index.idx_q + index.nq)
            if len(values) == 1 and index.nq == 2 and index.nv == 1 and not problem:
                values = (float(np.cos(values[0])), float(np.sin(values[0])))
            if not problem and len(values) != index.nq:
                problem = f"expected its value in numbers, {index.nq} of them, not '{joint.get('value', '')}'"
            if problem:
                raise DescriptionError(srdf, f"{element}: joint '{name}'", problem)
            q[positions] = values
        q = pin.normalize(model, q)
        if not np.isfinite(q).all():
            raise DescriptionError(srdf, element, "expected quaternions and cosine-sine pairs other than zero")
        model.referenceConfigurations[str(state.get("name"))] = q
