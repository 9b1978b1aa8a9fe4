"""The general engine over many poses, against the bare Pinocchio calls for the same Jacobians in a Python loop."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from pm3dof_pin.elastic import ElasticModel, cartesian_compliance, compliance_over
from pm3dof_pin.kinematics.robot import Robot

POSES = 4000
ROBOTS = ("pm3dof", "hexapod", "three_rps")


def best_time(work: Callable[[], object], repeats: int = 7) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def bare_calls(mechanism: Robot, positions: np.ndarray) -> Callable[[], None]:
    """Joint Jacobians, constraints and their Jacobian, frame Jacobian: what any condensation needs of Pinocchio."""
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


def nearby_configurations(mechanism: Robot, count: int) -> np.ndarray:
    generator = np.random.default_rng(0)
    home = mechanism.home.q
    found = []
    for _ in range(count):
        guess = pin.integrate(mechanism.model, home, generator.uniform(-0.05, 0.05, mechanism.model.nv))
        found.append(mechanism.assemble(guess).q)
    return np.array(found)


def main() -> None:
    for robot in ROBOTS:
        model = ElasticModel.load(robot)
        some = nearby_configurations(model.rigid, 50)
        rigid = np.tile(some, (POSES // len(some), 1))
        elastic = np.ascontiguousarray(model.embed(rigid))
        compliance_over(model, rigid[:1])
        bare = best_time(bare_calls(model.mechanism, elastic)) / POSES
        sweep = best_time(lambda model=model, rigid=rigid: compliance_over(model, rigid)) / POSES
        alone = best_time(lambda model=model, rigid=rigid: compliance_over(model, rigid, workers=1)) / POSES
        single = best_time(lambda model=model, some=some: [cartesian_compliance(model, q) for q in some]) / len(some)
        rows = len(model.rigid.home.closure_error)
        print(
            f"{robot}: {model.mechanism.model.nv} velocities, {rows} closure equations, {len(model.springs)} springs\n"
            f"  bare Pinocchio calls   {1e6 * bare:6.1f} us a pose\n"
            f"  compliance_over        {1e6 * sweep:6.1f} us a pose, {sweep / bare:.1f} times the bare calls\n"
            f"    with one worker      {1e6 * alone:6.1f} us a pose, {alone / bare:.1f} times\n"
            f"  cartesian_compliance   {1e6 * single:6.1f} us a pose, {single / bare:.0f} times the bare calls"
        )


if __name__ == "__main__":
    main()
