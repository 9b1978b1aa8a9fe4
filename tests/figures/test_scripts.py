"""The scripts of the published figures run without arguments and say where they put what."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import matplotlib.image
import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("figure_8_1", ["figure_8_1.pdf", "figure_8_1.png", "figure_8_1.svg"]),
        ("figure_8_2", ["figure_8_2.png", "figure_8_2_boundary.csv"]),
        ("figure_8_3", ["figure_8_3a.png", "figure_8_3b.png", "figure_8_3c.png"]),
        ("figure_8_4", ["figure_8_4.png"]),
        ("figure_8_5", ["figure_8_5.pdf", "figure_8_5.png", "figure_8_5.svg"]),
        ("figure_8_6", ["figure_8_6.pdf", "figure_8_6.png", "figure_8_6.svg"]),
        (
            "studies/passive_leg_radius",
            ["passive_leg_radius.pdf", "passive_leg_radius.png", "passive_leg_radius.svg"],
        ),
    ],
)
def test_script(
    name: str, files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert SCRIPTS.parent / "results" == script.RESULTS
    monkeypatch.setattr(script, "RESULTS", tmp_path)
    script.main()
    printed = capsys.readouterr().out.splitlines()
    assert printed[: len(files)] == [str(tmp_path / file) for file in files]
    assert sorted(path.name for path in tmp_path.iterdir()) == files
    for file in files:
        content = (tmp_path / file).read_bytes()
        if file.endswith(".png"):
            assert matplotlib.image.imread(tmp_path / file).std() > 0.05
        elif not file.endswith(".csv"):
            assert content.lstrip().startswith(b"%PDF" if file.endswith(".pdf") else b"<?xml")
