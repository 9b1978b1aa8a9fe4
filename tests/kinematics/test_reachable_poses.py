"""Random poses within all limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot


def test_a_block_has_no_poses_to_choose_from(tmp_path: Path) -> None:
    path = tmp_path / "block.urdf"
    path.write_text('<robot name="block"><link name="base"/></robot>')
    with pytest.raises(UnreachablePoseError, match="block: has no coordinates"):
        reachable_poses(Robot.load(path), 3, np.random.default_rng(0))
