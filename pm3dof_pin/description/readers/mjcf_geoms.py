"""Geoms of MJCF: shapes, and the inertia of bodies that are given none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.description import Inertial, Placement, Shape
from pm3dof_pin.description.mesh_files import read_meshes
from pm3dof_pin.description.own_files import require_own
from pm3dof_pin.description.physical_bounds import ANY, LENGTH, MASS, NOT_NEGATIVE, SIZE
from pm3dof_pin.description.readers.elements import named
from pm3dof_pin.description.readers.mjcf_elements import MjcfElements, least_turn_of_z
from pm3dof_pin.description.readers.mjcf_inertia import SOLIDS, geom_inertia, mesh_inertia
from pm3dof_pin.description.xml_file import Element, children

_HIDDEN_GROUP = 3  # geoms of this group and later ones are not shown by default


@dataclass(frozen=True)
class GeomShape:
    """The shape of a geom, and what it is for."""

    shape: Shape
    is_shown: bool
    collides: bool


class MjcfGeoms:
    """Reads geoms.

    Args:
        elements: reads their attributes.
    """

    def __init__(self, elements: MjcfElements) -> None:
        self._elements = elements
        self.unknown_masses: list[str] = []  #: bodies with meshes whose files are missing
        meshes = [entry for entry in elements.document.sections("asset") if entry.tag == "mesh"]
        self._meshes = {mesh.get("name") or Path(mesh.get("file", "")).stem: mesh for mesh in meshes}

    def shape(self, given: Element, default_class: str, frame: pin.SE3) -> GeomShape | None:
        """Return the shape of a geom that stands in a frame of its body; None of scenery and unknown meshes."""
        reader = self._elements
        element = reader.resolved(given, default_class)
        place, kind = named(given), element.get("type", "sphere")
        pose = Placement.from_se3(frame * self._geom_pose(element, given))
        colour = self._colour(element, given)
        if "mesh" in element.attrib:
            asset = self._meshes.get(element.attrib["mesh"])
            if asset is None or "file" not in asset.attrib:
                return None
            mesh = reader.resolved(asset, "")
            scale = reader.numbers(mesh, "scale", 3, ANY, named(asset), (1.0, 1.0, 1.0))
            pose = Placement.from_se3(pose.se3 * self._reference(mesh, asset).inverse())
            path = str(reader.document.asset_path(asset, "meshdir"))
            shape = Shape("mesh", scale, pose, given.get("name", ""), path, colour)
        elif kind in SOLIDS:
            x, y, z = self._sizes(element, place, kind)
            name = given.get("name", "")
            match kind:
                case "sphere":
                    shape = Shape("sphere", (x,), pose, name, colour=colour)
                case "box":
                    shape = Shape("box", (2.0 * x, 2.0 * y, 2.0 * z), pose, name, colour=colour)
                case "ellipsoid":
                    shape = Shape("ellipsoid", (x, y, z), pose, name, colour=colour)
                case "capsule":
                    shape = Shape("capsule", (x, 2.0 * y), pose, name, colour=colour)
                case _:
                    shape = Shape("cylinder", (x, 2.0 * y), pose, name, colour=colour)
        else:  # planes and height fields are scenery
            return None
        return GeomShape(
            shape,
            reader.number(element, "group", ANY, place, 0.0) < _HIDDEN_GROUP,
            element.get("contype", "1") != "0" or element.get("conaffinity", "1") != "0",
        )

    def _colour(self, element: Element, given: Element) -> tuple[float, ...] | None:
        if "rgba" in element.attrib:
            return self._elements.numbers(element, "rgba", 4, ANY, named(given))
        for material in self._elements.document.sections("asset"):
            if material.tag == "material" and material.get("name") == element.get("material", ""):
                return self._elements.numbers(
                    self._elements.resolved(material, ""), "rgba", 4, ANY, named(material), (1.0,) * 4
                )
        return None

    def _geom_pose(self, element: Element, given: Element) -> pin.SE3:
        if "fromto" not in element.attrib:
            return self._elements.pose(element, given)
        numbers = np.array(self._elements.numbers(element, "fromto", 6, LENGTH, named(given)))
        return pin.SE3(least_turn_of_z(numbers[:3] - numbers[3:]), 0.5 * (numbers[:3] + numbers[3:]))

    def inertia(self, body: Element, name: str, default_class: str) -> Inertial | None:
        """Return the inertia of a body's geoms; None if they have no mass."""
        total = pin.Inertia.Zero()
        compiler = self._elements.document.compiler_of(body)
        first, last = (int(float(word)) for word in compiler.get("inertiagrouprange", "0 5").split())
        for given, frame, cls in self._geoms(body, pin.SE3.Identity(), default_class):
            element = self._elements.resolved(given, cls)
            if not first <= int(self._elements.number(element, "group", ANY, named(given), 0.0)) <= last:
                continue
            if (inertia := self._geom_mass(element, given, name)) is not None:
                total += (frame * self._geom_pose(element, given)).act(inertia)
        return Inertial.from_inertia(total) if total.mass > 0.0 else None

    def _geoms(self, element: Element, frame: pin.SE3, cls: str) -> list[tuple[Element, pin.SE3, str]]:
        """Return the geoms of a body, also in frames, each with the frame that it stands in and its class."""
        found = [(geom, frame, cls) for geom in children(element, "geom")]
        for inner in children(element, "frame"):
            found += self._geoms(inner, frame * self._elements.pose(inner), inner.get("childclass") or cls)
        return found

    def _geom_mass(self, element: Element, given: Element, body: str) -> pin.Inertia | None:
        place, kind = named(given), element.get("type", "sphere")
        mass = self._elements.number(element, "mass", MASS, place, None)
        density = self._elements.number(element, "density", NOT_NEGATIVE, place, 1000.0)  # kg/m^3
        if mass == 0.0 or (mass is None and density == 0.0):
            return None
        shell = element.get("shellinertia") == "true"
        if "mesh" in element.attrib:
            mesh = self._triangles(element, given)
            if mesh is None or kind != "mesh":
                self.unknown_masses.append(body)
                return None
            method = "shell" if shell else mesh[2]
            return mesh_inertia(mesh[0], mesh[1], mass, density, method)
        if kind not in SOLIDS:
            return None
        sizes = self._sizes(element, place, kind)
        if 0.0 in sizes[: SOLIDS[kind][0]]:
            raise given.origin.error(place, f"a {kind} without size has no inertia: expected {SOLIDS[kind][0]} sizes")
        return geom_inertia(kind, sizes, mass, density, shell=shell)

    def _sizes(self, element: Element, place: str, kind: str) -> tuple[float, ...]:
        sizes = list(self._elements.numbers(element, "size", None, SIZE, place, (0.0,)))[:3]
        sizes += [0.0] * (3 - len(sizes))
        if "fromto" in element.attrib:
            numbers = np.array(self._elements.numbers(element, "fromto", 6, LENGTH, place))
            half = 0.5 * float(np.linalg.norm(numbers[3:] - numbers[:3]))
            sizes = [sizes[0], half, 0.0] if kind in ("capsule", "cylinder") else [sizes[0], sizes[0], half]
        return tuple(sizes)

    def _triangles(self, element: Element, given: Element) -> tuple[np.ndarray, np.ndarray, str] | None:
        """Return vertices [m] and faces of a geom's mesh, and the method of its inertia; None without its file."""
        name = element.get("mesh", "")
        if (asset := self._meshes.get(name)) is None:
            raise given.origin.error(named(given), f"expected an existing mesh, not '{name}'")
        mesh = self._elements.resolved(asset, "")
        scale = np.array(self._elements.numbers(mesh, "scale", 3, ANY, named(asset), (1.0, 1.0, 1.0)))
        if "vertex" in mesh.attrib:
            vertices = np.array(self._elements.numbers(mesh, "vertex", None, ANY, named(asset))).reshape(-1, 3)
            faces = np.array(self._elements.numbers(mesh, "face", None, ANY, named(asset), ()), dtype=int).reshape(
                -1, 3
            )
            if not len(faces):
                faces = _hull(vertices, asset)
        else:
            path = self._elements.document.asset_path(asset, "meshdir")
            require_own(path, self._elements.document.folders, asset.origin, named(asset))
            if not path.is_file() or path.suffix.lower() == ".msh":
                return None
            if not (parts := read_meshes(path)):
                return None
            ends = np.cumsum([0, *(len(part.vertices) for part in parts)])
            vertices = np.concatenate([np.asarray(part.vertices) for part in parts])
            faces = np.concatenate([np.asarray(part.faces) + end for part, end in zip(parts, ends, strict=False)])
        method = mesh.get("inertia", "legacy")
        if method == "convex":
            faces = _hull(vertices, asset)
        reference = self._reference(mesh, asset)
        moved = (vertices - reference.translation) @ reference.rotation * scale
        return moved, faces if scale.prod() > 0.0 else faces[:, ::-1], method

    def _reference(self, mesh: Element, asset: Element) -> pin.SE3:
        """Return the frame in a mesh's file that its `refpos` and `refquat` make its own."""
        place = named(asset)
        position = self._elements.numbers(mesh, "refpos", 3, ANY, place, (0.0, 0.0, 0.0))
        turn = self._elements.numbers(mesh, "refquat", 4, ANY, place, (1.0, 0.0, 0.0, 0.0))
        return Placement.from_quaternion(position, turn).se3


def _hull(vertices: np.ndarray, asset: Element) -> np.ndarray:
    """Return the outward triangles of the convex hull, as indices of vertices, shape=(n, 3)."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        faces = ConvexHull(vertices).simplices
    except (QhullError, ValueError) as error:
        raise asset.origin.error(named(asset), "has no volume, expected vertices that are not in a plane") from error
    outward = np.linalg.det(vertices[faces] - vertices.mean(axis=0)) > 0.0
    return np.asarray(np.where(outward[:, None], faces, faces[:, ::-1]))
