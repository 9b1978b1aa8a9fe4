"""Models compiled by MuJoCo (`mujoco.MjModel`), for those who have one in memory; MJCF files are read without it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Command
from pm3dof_pin.description.couplings import Coupling, polynomial_of_difference
from pm3dof_pin.description.description import (
    IDENTITY,
    Body,
    Description,
    Drive,
    Frame,
    Inertial,
    Joint,
    JointType,
    Placement,
    Unread,
)
from pm3dof_pin.description.origin import Origin
from pm3dof_pin.description.readers.control_laws import with_control_law
from pm3dof_pin.description.readers.elements import free_name

_FREE, _BALL, _SLIDE = 0, 1, 2  # mjtJoint
_CONNECT, _WELD, _JOINT = 0, 1, 2  # mjtEq
_OF_JOINT = (0, 1)  # mjtTrn
_FIXED_GAIN, _AFFINE_BIAS = 0, 1  # mjtGain; mjtBias, of which 0 is none
_LAGS = (0, 2, 3)  # mjtDyn: none, filter, filterexact
_TYPES: dict[int, JointType] = {_FREE: "floating", _BALL: "spherical", _SLIDE: "prismatic", 3: "revolute"}


def describe_mujoco(model: Any) -> Description:
    """Return the description of a compiled model, its bodies, sites, joints, equalities, actuators and keyframes.

    Actuators of other things than hinges and slides, and equalities of tendons, are listed as unread.
    """
    return _Compiled(model).description()


class _Compiled:
    def __init__(self, model: Any) -> None:
        self.model = model
        name = model.names[: model.names.find(b"\0")].decode() or "robot"
        self.origin = Origin(name)
        self.bodies = [model.body(k).name or ("world" if k == 0 else f"body{k}") for k in range(model.nbody)]
        self.joints = [model.joint(k).name or f"joint{k}" for k in range(model.njnt)]
        self.frames: dict[str, Frame] = {}
        self.unread: list[Unread] = []

    def description(self) -> Description:
        model = self.model
        bodies = [self._body(k) for k in range(model.nbody)]
        joints, carriers = self._joints()
        for k in range(model.nsite):
            if name := model.site(k).name:
                frame = free_name(name, {*self.bodies, *self.frames}, "_site")
                placement = _placement(model.site_pos[k], model.site_quat[k])
                self.frames[frame] = Frame(frame, self.bodies[model.site_bodyid[k]], placement)
        closures, couplings = self._equalities()
        drives = self._drives()
        driven = dict.fromkeys(drive.joint for drive in drives)
        return Description(
            str(self.origin.path),
            (*bodies, *carriers),
            tuple(joints),
            tuple(self.frames.values()),
            tuple(closures),
            tuple(couplings),
            tuple(drives),
            tuple(driven),
            tuple(
                Command(next(d.name for d in drives if d.joint == name), name, "m" if self._slides(name) else "rad")
                for name in driven
            ),
            configurations=self._configurations(),
            gravity=tuple(float(part) for part in model.opt.gravity),
            unread=tuple(self.unread),
            dialect="mujoco",
            origin=self.origin,
        )

    def _slides(self, joint: str) -> bool:
        return bool(self.model.jnt_type[self.joints.index(joint)] == _SLIDE)

    def _body(self, k: int) -> Body:
        model, mass = self.model, float(self.model.body_mass[k])
        moments = (*(float(moment) for moment in model.body_inertia[k]), 0.0, 0.0, 0.0)
        inertial = Inertial(mass, _placement(model.body_ipos[k], model.body_iquat[k]), moments) if k and mass else None
        return Body(self.bodies[k], inertial)

    def _joints(self) -> tuple[list[Joint], list[Body]]:
        model = self.model
        joints, carriers = [], []
        for k in range(1, model.nbody):
            parent, placement = (
                self.bodies[model.body_parentid[k]],
                _placement(model.body_pos[k], model.body_quat[k]).se3,
            )
            first, count = int(model.body_jntadr[k]), int(model.body_jntnum[k])
            if not count:
                name = f"{self.bodies[k]}_fixed"
                joints.append(Joint(name, "fixed", parent, self.bodies[k], Placement.from_se3(placement)))
            for index in range(first, first + count):
                child = self.bodies[k]
                if index < first + count - 1:
                    child = f"{self.joints[index]}_body"
                    carriers.append(Body(child))
                joints.append(self._joint(index, parent, child, placement))
                parent, placement = child, pin.SE3.Identity()
        return joints, carriers

    def _joint(self, k: int, parent: str, child: str, placement: pin.SE3) -> Joint:
        model, dof = self.model, int(self.model.jnt_dofadr[k])
        kind = _TYPES[int(model.jnt_type[k])]
        anchor = pin.SE3(np.eye(3), np.array(model.jnt_pos[k]))
        is_single = kind in ("revolute", "prismatic")
        is_limited = is_single and bool(model.jnt_limited[k])
        lower, upper = (float(end) if is_limited else None for end in model.jnt_range[k])
        return Joint(
            self.joints[k],
            kind,
            parent,
            child,
            IDENTITY if kind == "floating" else Placement.from_se3(placement * anchor),
            IDENTITY if kind == "floating" else Placement.from_se3(anchor.inverse()),
            axis=tuple(float(part) for part in model.jnt_axis[k]),
            lower=lower,
            upper=upper,
            effort=float(model.jnt_actfrcrange[k, 1]) if model.jnt_actfrclimited[k] else None,
            damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            stiffness=float(model.jnt_stiffness[k]),
            rest=float(model.qpos_spring[model.jnt_qposadr[k]]) if is_single else 0.0,
            zero=float(model.qpos0[model.jnt_qposadr[k]]) if is_single else 0.0,
        )

    def _equalities(self) -> tuple[list[LoopClosure], list[Coupling]]:
        model = self.model
        closures, couplings = [], []
        for k in range(model.neq):
            kind, data = int(model.eq_type[k]), model.eq_data[k]
            name = model.equality(k).name or f"{'weld' if kind == _WELD else 'connect'}{k + 1}"
            one, other = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            if not model.eq_active0[k] or kind not in (_CONNECT, _WELD, _JOINT) or (kind == _JOINT and other < 0):
                self.unread.append(Unread(f"equality '{name}'", self.origin))
            elif kind == _JOINT:
                zeros = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (one, other)]
                powers = polynomial_of_difference([float(number) for number in data[:5]], zeros[1])
                powers[0] += zeros[0]
                couplings.append(Coupling.from_powers(self.joints[one], self.joints[other], powers))
            else:
                holds_turn = kind == _WELD and data[10] != 0.0
                if int(model.eq_objtype[k]) != 1:  # mjOBJ_BODY; otherwise sites
                    ends = [model.site(index).name for index in (one, other)]
                    ends = [end if end in self.frames else f"{end}_site" for end in ends]
                else:
                    anchors = [_placement(data[0:3]), _placement(data[3:6])]
                    if kind == _WELD:
                        anchors = [_placement(data[3:6], data[6:10]), anchors[0]]
                    ends = []
                    for body, anchor in zip((one, other), anchors, strict=True):
                        ends.append(f"{name}_{self.bodies[body]}")
                        self.frames[ends[-1]] = Frame(ends[-1], self.bodies[body], anchor)
                closures.append(LoopClosure(ends[0], ends[1], "6d" if holds_turn else "3d"))
        return closures, couplings

    def _drives(self) -> list[Drive]:
        model, drives = self.model, []
        for k in range(model.nu):
            name, joint = model.actuator(k).name, int(model.actuator_trnid[k, 0])
            if int(model.actuator_trntype[k]) not in _OF_JOINT or int(model.jnt_type[joint]) in (_FREE, _BALL):
                self.unread.append(Unread(f"actuator '{name}'", self.origin, "drives no hinge or slide"))
                continue
            ranges = [
                (float(ends[0]), float(ends[1])) if limited else None
                for ends, limited in (
                    (model.actuator_ctrlrange[k], model.actuator_ctrllimited[k]),
                    (model.actuator_forcerange[k], model.actuator_forcelimited[k]),
                )
            ]
            drive = Drive(
                name or self.joints[joint],
                self.joints[joint],
                float(model.actuator_gear[k, 0]),
                kind="general",
                control_range=ranges[0],
                force_range=ranges[1],
            )
            laws = (model.actuator_gaintype[k], model.actuator_biastype[k], model.actuator_dyntype[k])
            if laws[0] == _FIXED_GAIN and laws[1] <= _AFFINE_BIAS and laws[2] in _LAGS:
                gain, bias = float(model.actuator_gainprm[k, 0]), model.actuator_biasprm[k, :3]
                drive = with_control_law(drive, gain, [float(part) for part in bias] if laws[1] else (0.0, 0.0, 0.0))
            drives.append(drive)
        return drives

    def _configurations(self) -> dict[str, dict[str, tuple[float, ...]]]:
        model = self.model
        given = {"qpos0": model.qpos0} | {model.key(k).name or f"key{k}": model.key_qpos[k] for k in range(model.nkey)}
        given.setdefault("home", model.qpos0)
        return {name: self._positions(qpos) for name, qpos in given.items()}

    def _positions(self, qpos: Any) -> dict[str, tuple[float, ...]]:
        values = {}
        for name, kind, start in zip(self.joints, self.model.jnt_type, self.model.jnt_qposadr, strict=True):
            size = {_FREE: 7, _BALL: 4}.get(int(kind), 1)
            numbers = [float(number) for number in qpos[start : start + size]]
            if size > 1:  # MuJoCo's quaternions begin with w
                numbers = [*numbers[:-4], *numbers[-3:], numbers[-4]]
            values[name] = tuple(numbers)
        return values


def _placement(position: Any, quaternion: Any = (1.0, 0.0, 0.0, 0.0)) -> Placement:
    xyz = tuple(float(part) for part in position[:3])
    return Placement.from_quaternion(xyz, tuple(float(part) for part in quaternion))
