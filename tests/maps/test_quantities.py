"""Quantities of maps that are not in closed form, against the engine that they come from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import placement
from pm3dof_pin.description.parameters import default_parameters_path
from pm3dof_pin.dynamics import natural_frequencies
from pm3dof_pin.elastic import ElasticModel
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.maps.quantities import Evaluation


def test_natural_frequencies_are_those_at_each_pose(tripod: Tripod, reachable_poses: np.ndarray) -> None:
    """Joint angles here by the general inverse geometry, in the map by the closed form."""
    poses = np.concatenate([reachable_poses[:5], [[0.0, 0.0, 2.0]]])
    found = Evaluation(tripod, poses.reshape(2, 3, 3)).natural_frequencies().reshape(6, 6)
    model = ElasticModel.load("pm3dof")
    q = np.array([model.rigid.inverse_geometry(placement(pose)).q for pose in poses[:5]])
    np.testing.assert_allclose(found[:5], natural_frequencies(model, q, count=6), rtol=1e-9)
    assert np.isnan(found[5]).all()


def test_natural_frequencies_of_a_machine_without_masses_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    text = default_parameters_path().read_text()
    assert "value: 353.0, unit: mm" in text  # the links
    other.write_text(text.replace("value: 353.0, unit: mm", "value: 354.0, unit: mm"))
    with pytest.raises(InvalidValueError, match="whose URDF has the masses"):
        Evaluation(Tripod.load(other), np.zeros((1, 3))).natural_frequencies()
