"""The tripod family in closed form: n actuated prismatic-universal-spherical legs and a passive leg."""

from pm3dof_pin.chapter.tripod import Tripod

__all__ = ["Tripod"]
