"""The visual geometry of a robot: shapes and mesh files on the frames of its model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.description import Description, Placement, Shape, ShapeKind
from pm3dof_pin.description.mesh_files import find_mesh
from pm3dof_pin.exceptions import DescriptionError


@dataclass(frozen=True)
class Visual:
    """A shape on a body; `path` is the file of a mesh."""

    body: str
    shape: Shape
    path: Path | None = None


def read_visuals(description: Description) -> list[Visual]:
    """Return the visual shapes of a robot, with the files of its meshes.

    Shapes without a name get that of their body with a number.

    Raises:
        DescriptionError: a mesh is missing, or lies outside the folders of the robot, see
            :func:`~pm3dof_pin.description.mesh_files.find_mesh`.
    """
    visuals = []
    for body in description.bodies:
        for number, shape in enumerate(body.visuals):
            path = None
            if shape.kind == "mesh":
                if description.files is None:
                    raise DescriptionError(description.name, f"mesh '{shape.mesh}'", "expected the robot's files")
                path = find_mesh(description.files, shape.mesh)
            visuals.append(Visual(body.name, replace(shape, name=f"{body.name}_{number}"), path))
    return visuals


def visuals_of_geometry(model: pin.Model, geometry: pin.GeometryModel) -> Iterator[Visual]:
    """Yield the shapes of a geometry model of Pinocchio that can be described."""
    for shape in geometry.geometryObjects:
        frame = model.frames[shape.parentFrame]
        placement = Placement.from_se3(frame.placement.actInv(shape.placement))
        solid, kind = shape.geometry, type(shape.geometry).__name__
        colour = tuple(float(part) for part in shape.meshColor)
        described: Shape | None = None
        if hasattr(solid, "num_tris"):
            scale = tuple(float(part) for part in shape.meshScale)
            colours = colour if shape.overrideMaterial else None
            described = Shape("mesh", scale, placement, shape.name, str(shape.meshPath), colours)
        elif kind == "Box":
            sizes = tuple(float(2.0 * half) for half in solid.halfSide)
            described = Shape("box", sizes, placement, shape.name, colour=colour)
        elif kind == "Sphere":
            described = Shape("sphere", (float(solid.radius),), placement, shape.name, colour=colour)
        elif kind == "Ellipsoid":
            radii = tuple(float(radius) for radius in np.asarray(solid.radii))
            described = Shape("ellipsoid", radii, placement, shape.name, colour=colour)
        elif kind in ("Cylinder", "Capsule"):
            sizes = float(solid.radius), float(2.0 * solid.halfLength)
            form: ShapeKind = "cylinder" if kind == "Cylinder" else "capsule"
            described = Shape(form, sizes, placement, shape.name, colour=colour)
        if described is not None:
            yield Visual(frame.name, described, Path(described.mesh) if described.mesh else None)
