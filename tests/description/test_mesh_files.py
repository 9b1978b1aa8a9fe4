"""Mesh files: read in a process of their own, whatever is in them, and only those that belong to the robot."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pm3dof_pin.description import mesh_files
from pm3dof_pin.description.mesh_files import find_mesh, read_meshes
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import DescriptionError

_KINDS = ("stl", "obj", "ply", "off", "glb", "3mf", "dae")


def _write(folder: Path, kind: str) -> Path:
    path = folder / f"ball.{kind}"
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(path)
    return path


@pytest.mark.parametrize("kind", _KINDS)
def test_a_mesh_is_read_as_it_is(tmp_path: Path, kind: str) -> None:
    (mesh,) = read_meshes(_write(tmp_path, kind))
    assert mesh.faces.shape == (80, 3)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1.0, atol=1e-6)
    again = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert again.volume == pytest.approx(trimesh.creation.icosphere(subdivisions=1).volume, rel=1e-6)


@pytest.mark.parametrize("kind", _KINDS)
def test_a_hundred_damaged_files_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    """Bytes changed, removed or repeated: a mesh with finite shape, or one error that names the file."""
    whole = _write(tmp_path, kind).read_bytes()
    rng = np.random.default_rng(0)
    path, refusals = tmp_path / f"damaged.{kind}", list[str]()
    for _ in range(100):
        content = bytearray(whole)
        at, count = int(rng.integers(len(content))), int(rng.integers(1, 20))
        match int(rng.integers(4)):
            case 0:
                content[at : at + count] = rng.integers(0, 256, count, dtype=np.uint8).tobytes()
            case 1:
                del content[at:]
            case 2:
                del content[at : at + count]
            case _:
                content[at:at] = content[at : at + 50 * count]
        path.write_bytes(bytes(content))
        try:
            meshes = read_meshes(path)
        except DescriptionError as caught:
            refusals.append(str(caught))
        else:
            assert all(mesh.faces.max(initial=-1) < len(mesh.vertices) for mesh in meshes)
    assert refusals or kind == "stl"  # whose bytes are all numbers
    assert all(text.startswith(f"{path}: mesh: ") and "\n" not in text for text in refusals)
    assert not any("too much time" in text or "aborted" in text for text in refusals)


def test_a_file_that_wants_all_memory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bomb.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 400000000000\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n3 0 0 0\n"
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", b"<model>" + b" " * (64 << 20))
    (tmp_path / "bomb.3mf").write_bytes(packed.getvalue())
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
    (tmp_path / "bomb.dae").write_text(f'<!DOCTYPE x [<!ENTITY e0 "aaaaaaaaaa">{entities}]><COLLADA>&e9;</COLLADA>')
    for kind in ("ply", "3mf", "dae"):
        with pytest.raises(DescriptionError, match=rf"bomb\.{kind}: mesh: expected a readable mesh"):
            read_meshes(tmp_path / f"bomb.{kind}")
    assert read_meshes(_write(tmp_path, "stl"))


def test_a_file_that_takes_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _write(tmp_path, "stl")
    monkeypatch.setattr(mesh_files, "_MAX_SECONDS", 0.0)
    with pytest.raises(DescriptionError, match="takes too much time"):
        read_meshes(path)
    monkeypatch.undo()
    assert read_meshes(path)


def test_buffers_outside_the_folder_are_refused(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    for name, content in trimesh.exchange.gltf.export_gltf(
        trimesh.Scene(trimesh.creation.box()), embed_buffers=False
    ).items():
        (tmp_path / name).write_bytes(content)
    assert read_meshes(tmp_path / "model.gltf")
    document = json.loads((tmp_path / "model.gltf").read_text())
    for buffer in document["buffers"]:
        buffer["uri"] = f"../{buffer['uri']}"
    (inner / "model.gltf").write_text(json.dumps(document))
    with pytest.raises(DescriptionError, match="expected a readable mesh"):
        read_meshes(inner / "model.gltf")


# Which files belong to a robot


_LINK = '<link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link>'


def _robot(folder: Path, mesh: str) -> Path:
    (folder / "urdf").mkdir(parents=True)
    path = folder / "urdf" / "arm.urdf"
    path.write_text(f'<robot name="arm">{_LINK.format(mesh)}</robot>')
    return path


@pytest.mark.parametrize("kind", ["package:///{}", "package://outer/{}", "{}", "file://{}", "package://../{}"])
def test_files_elsewhere_are_refused(tmp_path: Path, kind: str) -> None:
    outer = tmp_path / "outer"
    path = _robot(outer / "arm", "x")
    elsewhere = _write(outer, "stl")
    name = elsewhere.name if "outer" in kind or ".." in kind else str(elsewhere)
    with pytest.raises(DescriptionError, match=r"mesh '.*(expected a file in|expected an existing file)"):
        find_mesh(find_robot(path), kind.format(name.lstrip("/") if "///" in kind else name))


def test_packages_are_known_by_their_manifest(tmp_path: Path) -> None:
    outer = tmp_path / "outer"
    path = _robot(outer / "arm", "x")
    mesh = _write(outer, "stl")
    (outer / "package.xml").write_text("<package/>")
    assert find_mesh(find_robot(path), "package://outer/ball.stl") == mesh


def test_links_are_followed_before_they_are_judged(tmp_path: Path) -> None:
    path = _robot(tmp_path / "arm", "x")
    (tmp_path / "secret").write_text("root:x:0:0")
    (tmp_path / "arm" / "secret.txt").write_text("root:x:0:0")
    for name, target in (("out.stl", tmp_path / "secret"), ("in.stl", tmp_path / "arm" / "secret.txt")):
        (tmp_path / "arm" / "urdf" / name).symlink_to(target)
    with pytest.raises(DescriptionError, match=r"out\.stl.*expected a file in"):
        find_mesh(find_robot(path), "out.stl")
    with pytest.raises(DescriptionError, match=r"in\.stl.*expected a file of type"):
        find_mesh(find_robot(path), "in.stl")
