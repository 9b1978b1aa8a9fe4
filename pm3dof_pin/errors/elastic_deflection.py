"""Deflection of joints and links under the machine's own weight, a payload and a wrench on the tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.elastic.batch import compliance, elastic_model
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.loads import AppliedLoads, Loads
from pm3dof_pin.elastic.motions import elastic_motions
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array, Matrix


@dataclass(frozen=True, eq=False)
class ElasticDeflection:
    """Deflection of the description's springs, with commands held."""

    own_weight: bool = True  #: whether bodies have weight; deflection is relative to the weightless machine
    payload: float = 0.0  #: mass at the tool point [kg]
    #: whether to solve for the equilibrium under the loads at each pose
    #: (:mod:`pm3dof_pin.elastic.loaded`); otherwise linear
    large: bool = False

    def displacements(self, poses: Poses, wrenches: Array | None = None) -> Matrix:
        """Return the tool's deflection at n poses under dead wrenches [f; m], world axes, shape=(n, 6) [N, N m].

        Displacements are [translation; rotation vector], world axes, shape=(n, 6) [m, rad].

        Raises:
            DescriptionError: the robot has no springs, or no tool frame.
            FreeDirectionError: the tool can move with all springs at rest.
            ConvergenceError: no equilibrium was found, for large deflections.
            InvalidValueError: wrenches of another shape or not finite.
        """
        loads = np.zeros((len(poses), 6)) if wrenches is None else finite_array("wrenches", wrenches, (len(poses), 6))
        if self.large:
            return self._at_equilibrium(poses, loads)
        displacements = self._under_weights(poses)
        if loads.any():
            displacements += np.einsum("nij,nj->ni", compliance(poses.robot, poses), loads)
        return displacements

    def _under_weights(self, poses: Poses) -> Matrix:
        displacements = np.zeros((len(poses), 6))
        if not (self.own_weight or self.payload):
            return displacements
        model, tool = elastic_model(poses.robot), _tool(poses)
        weights = AppliedLoads(model.mechanism, [(1.0, Loads({}, {tool: self.payload}, self.own_weight))])
        for row, q in enumerate(poses.q):
            configuration = model.configuration(q)
            motions = elastic_motions(model, configuration).elastic
            displacements[row] = configuration.tool_jacobian @ motions @ (motions.T @ weights.forces(configuration))
        return displacements

    def _at_equilibrium(self, poses: Poses, wrenches: Array) -> Matrix:
        model, tool = elastic_model(poses.robot), _tool(poses)
        displacements = np.empty((len(poses), 6))
        for row, q in enumerate(poses.q):
            loads = Loads({tool: wrenches[row]}, {tool: self.payload}, self.own_weight)
            displacements[row] = loaded_equilibrium(model, q, loads).displacement()
        return displacements


def _tool(poses: Poses) -> str:
    name: str = poses.robot.frame_name()
    return name
