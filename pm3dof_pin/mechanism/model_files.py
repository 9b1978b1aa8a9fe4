"""SRDF files read into a Pinocchio model, with errors that name the place."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.physical_bounds import ANY, parse_numbers
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.exceptions import DescriptionError

_logger = logging.getLogger(__name__)


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
