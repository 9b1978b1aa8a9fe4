"""Objects for three.js: boxes, cylinders, spheres, meshes, lines, with their materials."""

from __future__ import annotations

import base64
import itertools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.viewer.scene import Json

Colour = tuple[float, float, float]

_numbers = itertools.count()


def box(lengths: ArrayLike) -> Json:
    """Return a box centred at the origin, shape=(3,) [m]."""
    width, height, depth = np.asarray(lengths, dtype=float).tolist()
    return {"type": "BoxGeometry", "width": width, "height": height, "depth": depth}


def cylinder(radius: float, length: float, top_radius: float | None = None) -> Json:
    """Return a cylinder or cone along the y axis, centred at the origin; :data:`Y_TO_Z` makes it upright."""
    top = radius if top_radius is None else top_radius
    return {
        "type": "CylinderGeometry",
        "radiusTop": top,
        "radiusBottom": radius,
        "height": length,
        "radialSegments": 48,
    }


def sphere(radius: float) -> Json:
    """Return a sphere centred at the origin."""
    return {"type": "SphereGeometry", "radius": radius, "widthSegments": 48, "heightSegments": 32}


def triangles(vertices: ArrayLike, faces: ArrayLike, colours: ArrayLike | None = None) -> Json:
    """Return a surface: vertices, shape=(n, 3) [m], faces indexing them, shape=(m, 3), and colours, shape=(n, 3)."""
    attributes = {"position": _attribute(vertices)}
    if colours is not None:
        attributes["color"] = _attribute(colours)
    kind, number = ("Uint16Array", np.uint16) if len(np.asarray(vertices)) <= 1 << 16 else ("Uint32Array", np.uint32)
    index = _typed(np.asarray(faces, dtype=number).ravel(), kind)
    return {"type": "BufferGeometry", "data": {"attributes": attributes, "index": {"type": kind, "array": index}}}


def mesh(geometry: Json, colour: Colour | None, *, opacity: float = 1.0, overlaid: bool = False) -> Json:
    """Return an object with a material, translucent if its opacity is below 1.

    Without a colour it has those of its vertices, unaffected by light, so that they match a scale. If `overlaid` it is
    drawn over all others, even if it is inside them.
    """
    if colour is None:
        material: Json = {"type": "MeshBasicMaterial", "color": 0xFFFFFF, "vertexColors": True}
    else:
        material = {"type": "MeshStandardMaterial", "color": _hexadecimal(colour), "roughness": 0.62, "metalness": 0.08}
    if overlaid:  # opaque objects are drawn first, so this one must be translucent
        return _lowered(
            "Mesh", geometry, {**material, "depthTest": False, "transparent": True, "opacity": min(opacity, 0.999)}
        )
    # smooth shading needs consistent winding, which foreign meshes may lack
    flat = {"flatShading": geometry["type"] == "BufferGeometry"} if colour else {}
    return _lowered("Mesh", geometry, {**material, **flat, "side": 2, **_translucent(opacity)})


def line_segments(points: ArrayLike, colour: Colour, *, opacity: float = 1.0, overlaid: bool = False) -> Json:
    """Return separate lines, one pixel wide, between pairs of points, shape=(2 n, 3) [m]; `overlaid` as in a mesh."""
    geometry = {"type": "BufferGeometry", "data": {"attributes": {"position": _attribute(points)}}}
    material = {"type": "LineBasicMaterial", "color": _hexadecimal(colour), **_translucent(opacity)}
    material |= {"depthTest": False, "transparent": True} if overlaid else {}
    return _lowered("LineSegments", geometry, material)


def points(positions: ArrayLike, colours: ArrayLike, size: float) -> Json:
    """Return round points, shape=(n, 3), of a size [m], in individual colours, shape=(n, 3)."""
    attributes = {"position": _attribute(positions), "color": _attribute(colours)}
    geometry = {"type": "BufferGeometry", "data": {"attributes": attributes}}
    material = {"type": "PointsMaterial", "color": 0xFFFFFF, "vertexColors": True, "size": size}
    return _lowered("Points", geometry, material)


def sprite(picture: str) -> Json:
    """Return a picture, given by URL, on a unit square that faces the camera and is drawn over all objects."""
    name = f"o{next(_numbers)}"
    material = {"type": "SpriteMaterial", "color": 0xFFFFFF, "depthTest": False, "transparent": True}
    return {
        "metadata": {"version": 4.5, "type": "Object"},
        "images": [{"uuid": f"{name}i", "url": picture}],
        "textures": [{"uuid": f"{name}t", "image": f"{name}i"}],
        "materials": [{"uuid": f"{name}m", **material, "map": f"{name}t"}],
        "object": {"uuid": name, "type": "Sprite", "material": f"{name}m"},
    }


def transform(rotation: ArrayLike | None = None, translation: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return the homogeneous matrix, shape=(4, 4), of a linear map, shape=(3, 3), and a translation, shape=(3,)."""
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = rotation
    if translation is not None:
        matrix[:3, 3] = translation
    return matrix


def turn_z_to(direction: ArrayLike) -> NDArray[np.float64]:
    """Return a rotation from the z axis to a direction, shape=(3, 3)."""
    z = np.asarray(direction, dtype=float)
    z = z / np.linalg.norm(z)
    beside = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(beside, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


Y_TO_Z = transform([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def _translucent(opacity: float) -> Json:
    return {"opacity": opacity, "transparent": True, "depthWrite": False} if opacity < 1.0 else {}


def _lowered(kind: str, geometry: Json, material: Json) -> Json:
    # three.js joins object, geometry and material by these names
    name = f"o{next(_numbers)}"
    return {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [{"uuid": f"{name}g", **geometry}],
        "materials": [{"uuid": f"{name}m", **material}],
        "object": {"uuid": name, "type": kind, "geometry": f"{name}g", "material": f"{name}m"},
    }


def _attribute(values: ArrayLike) -> Json:
    array = np.asarray(values, dtype=np.float32)
    return {"itemSize": 3, "type": "Float32Array", "normalized": False, "array": _typed(array.ravel(), "Float32Array")}


def bytes_of(places: ArrayLike) -> Json:
    """Return numbers between 0 and 1 in 255 steps, in the page's format."""
    return _typed(np.round(255.0 * np.asarray(places)).astype(np.uint8), "Uint8Array")


def _typed(array: NDArray[Any], kind: str) -> Json:
    """Return numbers in base64, which the page turns into a typed array: a tenth of their size as digits."""
    return {"typed_array": kind, "base64": base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()}


def _hexadecimal(colour: Colour) -> int:
    red, green, blue = (round(255.0 * min(1.0, max(0.0, float(part)))) for part in colour[:3])
    return (red << 16) + (green << 8) + blue
