"""The traced tree against Pinocchio, for every joint type."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.programs.tree import Tree

AXIS = np.array([0.36, -0.48, 0.8])


def composite():
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelRX(), pin.SE3.Random())
    joint.addJoint(pin.JointModelPrismaticUnaligned(AXIS), pin.SE3.Random())
    joint.addJoint(pin.JointModelSpherical(), pin.SE3.Random())
    return joint


def unbounded_unaligned():
    """Only the URDF reader makes one with an arbitrary axis."""
    urdf = f"""<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="1"/>
        <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="joint" type="continuous"><parent link="base"/><child link="arm"/>
        <axis xyz="{" ".join(map(str, AXIS))}"/></joint></robot>"""
    return pin.buildModelFromXML(urdf).joints[1].extract()


JOINTS = {
    **{name: getattr(pin, f"JointModel{name}") for name in ("RX", "RY", "RZ", "PX", "PY", "PZ")},
    **{name: getattr(pin, f"JointModel{name}") for name in ("RUBX", "RUBY", "RUBZ")},
    "RevoluteUnaligned": lambda: pin.JointModelRevoluteUnaligned(AXIS),
    "PrismaticUnaligned": lambda: pin.JointModelPrismaticUnaligned(AXIS),
    "RevoluteUnboundedUnaligned": lambda: unbounded_unaligned(),
    "Universal": lambda: pin.JointModelUniversal(pin.XAxis, pin.ZAxis),
    "SphericalZYX": pin.JointModelSphericalZYX,
    "Spherical": pin.JointModelSpherical,
    "Translation": pin.JointModelTranslation,
    "Planar": pin.JointModelPlanar,
    "FreeFlyer": pin.JointModelFreeFlyer,
    "Composite": composite,
}


def branched(kind: str) -> Mechanism:
    """Two branches with the joint in each, between revolute joints; a point and a frame closure join them."""
    model = pin.Model()
    model.name = kind
    trunk = model.addJoint(0, pin.JointModelRY(), pin.SE3.Random(), "trunk")
    ends = []
    for branch in "ab":
        first = model.addJoint(trunk, JOINTS[kind](), pin.SE3.Random(), f"{branch}_first")
        second = model.addJoint(first, pin.JointModelRZ(), pin.SE3.Random(), f"{branch}_second")
        ends.append(model.addJoint(second, JOINTS[kind](), pin.SE3.Random(), f"{branch}_third"))
        model.addFrame(pin.Frame(f"{branch}_tip", ends[-1], pin.SE3.Random(), pin.FrameType.OP_FRAME))
    closures = [LoopClosure("a_tip", "b_tip", "6d"), LoopClosure("b_tip", "a_tip", "3d")]
    return Mechanism(model, closures, tool_frame="b_tip")


def random_positions(mechanism: Mechanism, count: int) -> np.ndarray:
    model, generator = mechanism.model, np.random.default_rng(3)
    return np.array(
        [pin.integrate(model, pin.neutral(model), generator.uniform(-1.0, 1.0, model.nv)) for _ in range(count)]
    )


def evaluated(graph: Graph, outputs: dict, mechanism: Mechanism, q: np.ndarray) -> dict[str, np.ndarray]:
    program = graph.program("test", outputs)
    return program.split(program.evaluate(q, geometry.values(mechanism, program.parameters)))


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("kind", JOINTS)
def test_placements_and_jacobians(kind, dense):
    pin.seed(1)
    mechanism = branched(kind)
    model, data = mechanism.model, mechanism.model.createData()
    q = random_positions(mechanism, 20)
    graph = Graph()
    tree = Tree(graph, mechanism, q[:8], dense=dense)
    tip = tree.frame("b_tip")
    result = evaluated(
        graph, {"rotation": tip.rotation, "position": tip.translation, "jacobian": tree.jacobian("b_tip")}, mechanism, q
    )
    for k, positions in enumerate(q):
        pin.framesForwardKinematics(model, data, positions)
        frame = mechanism.frame_id("b_tip")
        expected = pin.computeFrameJacobian(model, data, positions, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(result["rotation"][k], data.oMf[frame].rotation, atol=1e-13)
        np.testing.assert_allclose(result["position"][k], data.oMf[frame].translation, atol=1e-13)
        np.testing.assert_allclose(result["jacobian"][k], expected, atol=1e-12)


@pytest.mark.parametrize("kind", JOINTS)
def test_step_is_pinocchios_integrate_to_first_order(kind):
    pin.seed(2)
    mechanism = branched(kind)
    model = mechanism.model
    q = random_positions(mechanism, 5)
    velocity = np.random.default_rng(0).uniform(-1.0, 1.0, model.nv)
    remaining = []
    for size in (1e-3, 1e-4):
        graph = Graph()
        tree = Tree(graph, mechanism, q)
        stepped = evaluated(graph, {"q": tree.step(dict(enumerate(size * velocity)))}, mechanism, q)["q"]
        remaining.append(
            max(
                np.abs(pin.difference(model, pin.integrate(model, a, size * velocity), b)).max()
                for a, b in zip(q, stepped, strict=True)
            )
        )
        assert all(pin.isNormalized(model, row, 1e-14) for row in stepped)
    assert remaining[0] < 1e-5
    assert remaining[1] < 2e-2 * remaining[0] + 1e-15


def test_parameters_serve_another_mechanism_of_the_same_structure():
    pin.seed(3)
    first, second = branched("Universal"), branched("Universal")
    assert geometry.structure(first) == geometry.structure(second)
    q = random_positions(first, 4)
    graph = Graph()
    tree = Tree(graph, first, q)
    result = evaluated(graph, {"p": tree.frame("a_tip").translation}, second, q)
    for k, positions in enumerate(q):
        expected = Configuration(second, positions).frame_placement("a_tip").translation
        np.testing.assert_allclose(result["p"][k], expected, atol=1e-13)


def test_other_constants_make_another_pattern():
    mechanism = branched("RX")
    other = mechanism.model.copy()
    other.jointPlacements[1] = pin.SE3.Identity()
    assert geometry.pattern(mechanism) != geometry.pattern(Mechanism(other, mechanism.closures, tool_frame="b_tip"))
