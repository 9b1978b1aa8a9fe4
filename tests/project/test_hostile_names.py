"""A robot's name is plain text wherever it is written: it is never markup, code or a formula."""

from __future__ import annotations

import html
import io
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_args
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import pinocchio as pin
import pytest
import yaml
from matplotlib.figure import Figure

import pm3dof_pin as pm
from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.report import report_as_html
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.export.controllers import ControllerName, export_controller
from pm3dof_pin.export.formats import FORMATS, export_robot
from pm3dof_pin.export.functions import export_functions
from pm3dof_pin.figures.labels import entry_words, parameter_words, part_words, plain, symbol
from pm3dof_pin.figures.style import house_style
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.viewer.showing import _page_html

NAMES = [
    "<!--<script>alert(1)</script>-->",
    "</script></robot>]]>",
    "*/ int x; /* \\",
    "\"'&\\",
    "a\nclosed_loop: []",
    "x\u2028closed_loop: []",
    "%{} {{7*7}} $page",
    "$\\frac{ $",
]
ALL = " ".join(NAMES)


class _Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.words = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.append(tag)

    def handle_comment(self, data: str) -> None:
        self.tags.append("comment")

    def handle_data(self, data: str) -> None:
        self.words += data


@pytest.mark.parametrize("name", [ALL, "a\\"])
def test_exported_files_are_sound(name: str, tmp_path: Path) -> None:
    source = find_robot("three_rps")
    text = source.path.read_text(encoding="utf-8")
    text = text.replace('name="three_rps"', f"name={quoteattr(name)}", 1)
    (tmp_path / "named.urdf").write_text(text, encoding="utf-8")
    assert source.closures is not None
    shutil.copy(source.closures, tmp_path / "named.closures.yaml")
    for form in FORMATS:
        export_robot(tmp_path / "named.urdf", form, tmp_path / form)
        for file in (path for path in (tmp_path / form).rglob("*") if path.is_file()):
            content = file.read_text(encoding="utf-8")
            if file.suffix in (".xml", ".urdf", ".sdf", ".srdf"):
                ElementTree.fromstring(content)
            elif file.suffix in (".yaml", ".rviz"):
                yaml.safe_load(content)
            elif file.suffix == ".py":
                compile(content, str(file), "exec")


@pytest.fixture(scope="module")
def renamed() -> pm.Robot:
    """An ankle whose robot and tool frame have hostile names."""
    robot = pm.load("ankle_rus")
    tool = robot.model.frames[robot.frame_id(str(robot.tool_frame))]
    model = robot.model.copy()
    model.name = ALL
    model.addFrame(pin.Frame(ALL, tool.parentJoint, tool.placement, pin.FrameType.OP_FRAME))
    return robot.replace(model=model, tool_frame=ALL)


@pytest.mark.parametrize("target", [*get_args(ControllerName), "numpy"])
def test_exported_kinematics_are_sound(target: Any, renamed: pm.Robot, tmp_path: Path) -> None:
    """Markup parses, the core compiles, and outside of comments and string literals nothing of a name is left."""
    if target == "numpy":
        export_functions(renamed, ["commands"], target, tmp_path)
    else:
        export_controller(renamed, target, tmp_path)
    for file in (path for path in tmp_path.rglob("*") if path.is_file()):
        text = file.read_text(encoding="utf-8")
        match file.suffix:
            case ".xml":
                ElementTree.fromstring(text)
            case ".py":
                compile(text, str(file), "exec")
            case ".md":
                assert not re.search(r"(?<!\\)<(?!transmission>)|^closed_loop", text, re.MULTILINE)
            case ".hal" | ".ini":
                assert not re.search(r"^(?!#).*(alert\(|closed_loop: )", text, re.MULTILINE)
            case ".c" | ".h" | ".cpp":
                code = re.sub(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"', "", text, flags=re.DOTALL)
                assert not re.search(r"alert\(|int x;|closed_loop:|\$", code)
                assert "\\\n" not in text.replace(" \\\n", "")
    if target == "c" and (compiler := shutil.which("gcc")):
        (source,) = tmp_path.glob("*.c")
        command = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", source]
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
        assert done.returncode == 0, done.stderr


def test_the_page_of_the_viewer() -> None:
    harmless = _page_html({"name": "arm"}, title="arm", served=False)
    page = _page_html({"name": ALL}, title=ALL, served=False)
    for sign in ("<script", "</script", "<!--", "-->"):
        assert page.count(sign) == harmless.count(sign), sign
    (data,) = re.findall(r'<script id="scene" type="application/json">(.*?)</script>', page)
    assert json.loads(data) == {"name": ALL}
    (title,) = re.findall(r"<title>(.*?)</title>", page, re.DOTALL)
    assert html.unescape(title) == ALL


@pytest.mark.usefixtures("report_without_pictures")
def test_the_report_of_a_calibration(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    measured = Measurements.from_poses(tripod_nominal.commands[:12], tripod_nominal.transforms[:12])
    calibration = calibrate(measured, tripod_errors, "lm", on_refusal="keep")
    summary, pictures = calibration.summary(), calibration.pictures()
    harmless, report = (
        _Tags(report_as_html(calibration, summary | {"robot": name}, pictures, None)) for name in ("arm", ALL)
    )
    assert report.tags == harmless.tags
    assert report.words == harmless.words.replace("Calibration of arm", f"Calibration of {ALL}")


def test_the_comment_of_printed_c(tmp_path: Path) -> None:
    graph = Graph()
    program = graph.program("twice", {ALL: graph.input("x", [1.0]) * graph.parameter(ALL, 2.0)})
    source = tmp_path / "twice.c"
    source.write_text(c99(program, summary=ALL, descriptions={ALL: ALL}, parameters=[2.0]), encoding="utf-8")
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    command = [compiler, "-std=c99", "-c", source, "-o", tmp_path / "twice.o"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.filterwarnings("ignore:Glyph")
@pytest.mark.parametrize("written", [plain, symbol, part_words, entry_words, parameter_words])
def test_a_dollar_begins_no_formula_in_pictures(written: Callable[[str], str]) -> None:
    with house_style():
        figure = Figure()
        figure.suptitle(written(NAMES[-1]))
        figure.savefig(file := io.BytesIO(), format="svg")
    assert ElementTree.fromstring(file.getvalue()) is not None
