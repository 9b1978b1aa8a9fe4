"""The chapter's stiffness map of 6,561 poses: time once compiled, compared with the same equations in a Python loop."""

from __future__ import annotations

import numpy as np
from timing import least_time

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.chapter_stiffness import chapter_stiffness
from pm3dof_pin.chapter.kinematics import link_jacobian, slider_jacobian
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.chapter.tilt_grids import RectangularGrid


def main() -> None:
    tripod = Tripod.load()
    poses = RectangularGrid().poses(tripod.middle_height).reshape(-1, 3)

    def one_by_one() -> None:
        p = tripod.parameters
        for pose in poses:
            j_a, j_t = link_jacobian(tripod, pose), slider_jacobian(tripod, pose)
            np.diag(p.link_stiffness * j_a.T @ j_a + p.actuator_stiffness * j_t.T @ j_t)

    whole = least_time(lambda: (chapter_stiffness(tripod, poses, on_failure="nan"), limit_flags(tripod, poses)))
    loop = least_time(one_by_one, tries=1)
    print(f"{len(poses)} poses, stiffness and limits: {1e3 * whole:.2f} ms, {1e6 * whole / len(poses):.2f} us/pose")
    print(f"pose by pose in Python: {1e3 * loop:.0f} ms, {loop / whole:.0f} times as long")


if __name__ == "__main__":
    main()
