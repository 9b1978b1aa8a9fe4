"""6 x 6 compliance and stiffness from q, compared with bare Pinocchio calls for the same Jacobians in a Python loop.

One thread; the least of many short runs, taken in turn, so that ratios hold on a busy machine too.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
from timing import least_times

from pm3dof_pin.elastic.batch import compliance, stiffness
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.mechanism.mechanism import Mechanism

POSES = 2000
FEW = 50
ROUNDS = 150
GOALS = {"pm3dof": 50, "hexapod": 50, "three_rps": 25}


def bare_calls(mechanism: Mechanism, positions: np.ndarray) -> Callable[[], None]:
    """Joint Jacobians, constraints and their Jacobian, frame Jacobian: what any condensation needs from Pinocchio."""
    model, data = mechanism.model, mechanism.model.createData()
    constraints, datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
    for closure in mechanism.closures:
        a, b = (model.frames[mechanism.frame_id(name)] for name in (closure.frame_a, closure.frame_b))
        anchor = pin.PointAnchorConstraintModel if closure.type == "3d" else pin.FrameAnchorConstraintModel
        constraint = pin.ConstraintModel(anchor(model, a.parentJoint, a.placement, b.parentJoint, b.placement))
        constraints.append(constraint)
        datas.append(constraint.createData())
    pairs, tool = list(zip(constraints, datas, strict=True)), mechanism.tool_frame_id

    def work() -> None:
        for q in positions:
            pin.computeJointJacobians(model, data, q)
            for constraint, constraint_data in pairs:
                constraint.calc(model, data, constraint_data)
            pin.getConstraintsJacobian(model, data, constraints, datas)
            pin.computeFrameJacobian(model, data, q, tool, pin.LOCAL_WORLD_ALIGNED)

    return work


def main() -> dict[str, float]:
    ratios: dict[str, float] = {}
    for robot, goal in GOALS.items():
        model = ElasticModel.load(robot)
        poses = reachable_poses(model.rigid, FEW, np.random.default_rng(0))
        many = Poses(model.rigid, np.tile(poses.q, (POSES // FEW, 1)))
        start = time.perf_counter()
        compliance(model, poses, threads=1)
        first = time.perf_counter() - start
        compliance(model, many[:1], threads=1)
        stiffness(model, many[:1], threads=1)
        times = least_times(
            {
                "bare": bare_calls(model.mechanism, np.ascontiguousarray(model.embed(poses.q))),
                "compliance": lambda model=model, many=many: compliance(model, many, threads=1),
                "stiffness": lambda model=model, many=many: stiffness(model, many, threads=1),
                "report": lambda model=model, poses=poses: [cartesian_compliance(model, q).stiffness for q in poses.q],
            },
            ROUNDS,
        )
        bare = times["bare"] / FEW
        print(f"{robot}: {model.mechanism.model.nv} velocities, {len(model.springs)} springs; first use {first:.2f} s")
        print(f"  bare Pinocchio calls   {1e6 * bare:8.3f} us/pose")
        for name in ("compliance", "stiffness"):
            each = times[name] / POSES
            ratios[f"{robot}: {name} against bare Pinocchio calls"] = bare / each
            print(f"  {name:<22} {1e6 * each:8.3f} us/pose, {bare / each:.0f} times faster (goal {goal})")
        print(f"  cartesian_compliance   {1e6 * times['report'] / FEW:8.1f} us")

    return ratios


if __name__ == "__main__":
    main()
