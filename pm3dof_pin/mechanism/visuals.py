"""The visual geometry of a robot: shapes and meshes on the frames of its model."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pinocchio as pin

from pm3dof_pin.description.mesh_files import find_mesh
from pm3dof_pin.description.mjcf import read_mjcf
from pm3dof_pin.description.own_files import require_own
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.mechanism.parser_messages import parser_messages


def read_visuals(model: pin.Model, files: RobotFiles) -> pin.GeometryModel:
    """Read the visual geometry of a model's files; `package://x/y` is the file `x/y` in one of their package paths.

    Raises:
        DescriptionError: a shape or mesh cannot be read, or a mesh lies outside the folders of the robot, see
            :func:`~pm3dof_pin.description.mesh_files.find_mesh`.
    """
    if files.format == "urdf":
        for name in {mesh.get("filename", "") for mesh in read_xml(files.path).iterfind("link/visual/geometry/mesh")}:
            find_mesh(files, name)
    try:
        if files.format == "urdf":
            packages = [str(path) for path in files.package_paths]
            with parser_messages():
                return pin.buildGeomFromUrdf(model, str(files.path), pin.GeometryType.VISUAL, package_dirs=packages)
        with tempfile.TemporaryDirectory(prefix="pm3dof_") as folder:
            copy = Path(folder) / "model.xml"
            copy.write_text(read_mjcf(files.path, files.own_folders).text, encoding="utf-8")
            shapes = pin.buildGeomFromMJCF(model, str(copy), pin.GeometryType.VISUAL)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise DescriptionError(files.path, "visual", f"expected readable shapes and meshes ({reason})") from error
    for path in {str(shape.meshPath) for shape in shapes.geometryObjects if Path(str(shape.meshPath)).is_file()}:
        require_own(Path(path), files.own_folders, files.path, "mesh")
    return shapes
