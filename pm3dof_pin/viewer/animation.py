"""A path as an animation of meshcat's page: key frames of all bodies and ellipsoids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from pm3dof_pin.typing import Array
from pm3dof_pin.viewer.scene import Json


def clips(tracks: Mapping[str, Sequence[Array]], frames_per_second: float) -> list[Json]:
    """Return the transforms of each path, one per frame, shape=(4, 4) each, as an animation for the page.

    The axes of ellipsoids, below /ellipsoids, are ordered and signed for interpolation.
    """
    found = []
    for path, transforms in tracks.items():
        moved = _aligned_ellipsoids(transforms) if path.startswith("/ellipsoids/") else transforms
        found.append({"path": path, "clip": {"fps": frames_per_second, "name": "path", "tracks": _tracks(moved)}})
    return found


def _aligned_ellipsoids(transforms: Sequence[Array]) -> list[Array]:
    """Return transforms of ellipsoids, shape=(4, 4) each, with axes ordered and signed for interpolation.

    The order and signs of an ellipsoid's axes are arbitrary; of the 24 right-handed choices, each frame takes the one
    that turns least.
    """
    from scipy.spatial.transform import Rotation  # slower to import than the rest of the page

    turns = np.round(Rotation.create_group("O").as_matrix())
    aligned = [np.array(transforms[0])]
    for transform in transforms[1:]:
        before, now = aligned[-1][:3, :3], transform[:3, :3]
        unit = before / np.linalg.norm(before, axis=0)
        choices = now @ turns
        best = max(choices, key=lambda axes: float(np.sum(unit * (axes / np.linalg.norm(axes, axis=0)))))
        moved = np.array(transform)
        moved[:3, :3] = best
        aligned.append(moved)
    return aligned


def _tracks(transforms: Sequence[Array]) -> list[Json]:
    positions: list[Array] = []
    quaternions: list[Array] = []
    scales: list[Array] = []
    for transform in transforms:
        lengths = np.linalg.norm(transform[:3, :3], axis=0)
        positions.append(transform[:3, 3])
        scales.append(lengths)
        quaternion = pin.Quaternion(transform[:3, :3] / lengths).coeffs()
        # of the two quaternions of a rotation, the one nearer to the previous frame, for the shorter turn
        near = not quaternions or float(quaternion @ quaternions[-1]) >= 0.0
        quaternions.append(quaternion if near else -quaternion)
    named = (
        ("position", "vector3", positions),
        ("quaternion", "quaternion", quaternions),
        ("scale", "vector3", scales),
    )
    return [
        {
            "name": f".{name}",
            "type": kind,
            "keys": [{"time": frame, "value": value.tolist()} for frame, value in enumerate(_single(values))],
        }
        for name, kind, values in named
    ]


def _single(values: Sequence[Array]) -> Array:
    """Round to single precision, as browsers animate; one value for all frames if it is constant."""
    rounded = np.array([[f"{entry:.8g}" for entry in value] for value in values], dtype=float)
    return rounded[:1] if np.all(rounded == rounded[0]) else rounded
