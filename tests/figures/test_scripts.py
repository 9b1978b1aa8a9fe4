"""Every script of the chapter runs on small input, writes to the given folder, and reports what it wrote."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib.image
import pytest

from pm3dof_pin.calibration import workspace_errors
from pm3dof_pin.figures import outlined_mesh, style

SCRIPTS = Path(__file__).parents[2] / "scripts"
ELSEWHERE = {"compatibility_table", "gallery", "generate_description"}
"""Those that need a browser, or that other tests run."""

IN_FULL = ("figure_8_1", "figure_8_4")
"""Those rendered at full resolution; the others are rendered more coarsely."""

VECTORS = ("dark.png", "pdf", "png", "svg")
RUNS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "figure_8_1": ({}, [f"figure_8_1.{kind}" for kind in VECTORS]),
    "figure_8_2": ({"sections": 13}, ["figure_8_2.png", "figure_8_2_boundary.csv"]),
    "figure_8_3": ({"points": 25}, [f"figure_8_3{panel}.png" for panel in "abc"]),
    "figure_8_4": ({"points": 13, "engine": "pinocchio"}, ["figure_8_4.png"]),
    "figure_8_5": ({"formats": ["svg"]}, ["figure_8_5.svg"]),
    "figure_8_6": ({"formats": ["svg"]}, ["figure_8_6.svg"]),
    "section_8_3": ({"points": 7, "poses": 12}, ["section_8_3_error_map.png", "section_8_3_error_map.csv"]),
    "table_8_1": ({}, ["table_8_1.csv", "table_8_2.csv"]),
    "table_8_3": ({}, ["table_8_3.csv"]),
    "table_8_4": ({"poses": 10}, ["table_8_4.csv"]),
    "studies/calibration_pictures": ({}, ["calibration_held_out.png", "calibration_maps.png"]),
    "studies/passive_leg_radius": ({"formats": ["png"]}, ["passive_leg_radius.png"]),
    "studies/plan_study": ({}, ["plan_study.md"]),
    "studies/universal_joint": ({"points": 5, "formats": ["png"]}, ["universal_joint.png"]),
}


def _load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name.replace("/", "_"), SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str((SCRIPTS / name).parent))  # as for a script
    try:
        spec.loader.exec_module(script)
    finally:
        sys.path.pop(0)
    return script


def test_none_is_forgotten() -> None:
    assert {path.stem for path in SCRIPTS.glob("*.py")} == {name for name in RUNS if "/" not in name} | ELSEWHERE


@pytest.mark.parametrize("name", RUNS)
def test_script(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    options, files = RUNS[name]
    if name not in IN_FULL:
        monkeypatch.setattr(style, "DPI", 100)
        monkeypatch.setattr(outlined_mesh, "_CELLS", 30)
        monkeypatch.setattr(workspace_errors, "_POINTS", 7)
    script = _load(name)
    if name == "studies/plan_study":
        small = {
            "shell_poses": 2,
            "candidates": 60,
            "test_poses": 8,
            "counts": (10,),
            "seeds": (0,),
            "strategies": ("space-filling",),
            "methods": ("lm", "gp"),
        }
        options = {"plan": script.StudyPlan(**small)}
    assert SCRIPTS.parent / "results" == script.RESULTS  # not under version control
    script.main(out=tmp_path, **options)
    printed = capsys.readouterr().out
    for file in files:
        assert re.search(rf"(^|wrote ){re.escape(str(tmp_path / file))}$", printed, re.MULTILINE)
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == sorted(files)
    for file in files:
        content = (tmp_path / file).read_bytes()
        if file.endswith(".png"):
            image = matplotlib.image.imread(tmp_path / file)
            assert image.std() > 0.05
            assert image.shape[1] <= style.TWO_COLUMNS * style.DPI
        elif file.endswith((".pdf", ".svg")):
            assert content.lstrip().startswith(b"%PDF" if file.endswith(".pdf") else b"<?xml")
        else:
            assert len(content.splitlines()) > 2


def test_the_gallery_says_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script = _load("gallery")
    monkeypatch.setenv("PM3DOF_BROWSER", "no-such-browser")
    with pytest.raises(SystemExit, match="no-such-browser"):
        script.main(tmp_path / "pictures")
    assert not list(tmp_path.iterdir())
