"""Pages of the examples and of the live robots, made when the documentation is built.

Every script of docs/examples is run in a folder of its own; its page shows its text, output and pictures. Every
robot's page of the viewer is written next to the documentation's, where docs/live.md embeds it.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.robot import load
from pm3dof_pin.viewer import Viewer

LIVE = ("pm3dof", "hexapod", "three_rps", "linear_delta")


def _run_examples(app: Sphinx) -> None:
    scripts = sorted((Path(app.srcdir) / "examples").glob("[0-9]*.py"))
    pages = Path(app.srcdir) / "examples" / "generated"
    shutil.rmtree(pages, ignore_errors=True)
    pages.mkdir()
    cards = []
    for script in scripts:
        with tempfile.TemporaryDirectory() as folder:
            ended = subprocess.run(
                [sys.executable, script],
                cwd=folder,
                env=os.environ | {"MPLBACKEND": "Agg"},
                capture_output=True,
                text=True,
                check=False,
            )
            if ended.returncode:
                raise RuntimeError(f"{script}: {ended.stderr}")
            pictures = sorted(Path(folder).glob("*.png"))
            for picture in pictures:
                shutil.copy(picture, pages)
            (pages / f"{script.stem}.md").write_text(_page(script, ended.stdout, pictures), encoding="utf-8")
            cards.append(_card(script, [picture.name for picture in pictures]))
    grid = "\n\n".join(["::::{grid} 1 2 3 3\n:gutter: 2", *cards, "::::"])
    (pages / "cards.txt").write_text(grid, encoding="utf-8")


def _card(script: Path, pictures: list[str]) -> str:
    """Return a card that links to an example's page, with its first picture if it has one."""
    title = (ast.get_docstring(ast.parse(script.read_text(encoding="utf-8"))) or "").partition("\n")[0].rstrip(".")
    picture = [f":img-top: generated/{pictures[0]}"] if pictures else []
    lines = [f":link: generated/{script.stem}", ":link-type: doc", *picture]
    return "\n".join([":::{grid-item-card}", *lines, f"{int(script.stem[:2])}. {title}", ":::"])


def _page(script: Path, printed: str, pictures: list[Path]) -> str:
    code = script.read_text(encoding="utf-8")
    module = ast.parse(code)
    title, _, text = (ast.get_docstring(module) or "").partition("\n")
    body = "\n".join(code.splitlines()[module.body[0].end_lineno or 0 :]).strip("\n")
    parts = [f"# {int(script.stem[:2])}. {title.rstrip('.')}", text.strip(), f"```python\n{body}\n```"]
    parts.append(f"```text\n{printed.strip()}\n```")
    parts += [f"```{{image}} {picture.name}\n:alt: {title}\n```" for picture in pictures]
    return "\n\n".join([*parts, f"The script: `docs/examples/{script.name}`.", ""])


def _write_live_pages(app: Sphinx, error: Exception | None) -> None:
    if error is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "live_pages"
    folder.mkdir(exist_ok=True)
    for name in LIVE:
        robot = load(name)
        viewer, model = Viewer(robot), ElasticModel(robot)
        try:
            compliance = cartesian_compliance(model, robot.home).compliance
            viewer.stiffness_ellipsoid(compliance=compliance, kind="translation")
            viewer.stiffness_ellipsoid(compliance=compliance, kind="rotation")
            viewer.load(model, [80.0, 0.0, 60.0, 0.0, 0.0, 0.0])  # an arrow beside the machine, to drag
            viewer.colour_legs(model, [0.0, 0.0, -100.0, 0.0, 0.0, 0.0], visible=False)
        except PM3DofError:
            viewer.motion_ellipsoid("velocity")
        viewer.save_html(folder / f"{name}.html")


def setup(app: Sphinx) -> ExtensionMetadata:
    """Run the examples before the pages are read, and write the live pages when all is written."""
    app.connect("builder-inited", _run_examples)
    app.connect("build-finished", _write_live_pages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
