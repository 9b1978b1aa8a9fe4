"""The numbered examples and the notebooks: each runs from an empty folder, and writes its results."""

from __future__ import annotations

import ast
import itertools
import runpy
import signal
from functools import partial
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("*.py"))
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_examples_are_numbered_and_short() -> None:
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, 14))
    for path in EXAMPLES:
        text = path.read_text(encoding="utf-8")
        assert text.count("\n") < 40, path.name
        title, blank, *rest = (ast.get_docstring(ast.parse(text)) or "").splitlines()
        assert title
        assert blank == ""
        assert rest


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run_in_an_empty_folder(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They print something, and write a picture or page that is not empty."""
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    if "distributed" in path.read_text(encoding="utf-8"):
        deploy = pytest.importorskip("distributed.deploy")  # threads suffice here; tests/maps uses processes
        monkeypatch.setattr(deploy, "LocalCluster", partial(deploy.LocalCluster, processes=False))
    with plt.rc_context({"backend": "agg"}):
        runpy.run_path(str(path), run_name="__main__")
        plt.close("all")
    assert capsys.readouterr().out.strip()
    assert any(made.stat().st_size > 8000 for made in tmp_path.iterdir() if made.suffix in (".png", ".html"))


def test_notebooks_run(tmp_path: Path) -> None:
    """In one kernel, which takes longer to start than they run; each without the variables of the others."""
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    together, ends = nbformat.v4.new_notebook(), [0]
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        nbformat.validate(notebook)
        assert not any(cell.get("outputs") for cell in notebook.cells)  # committed without outputs, which vary
        together.cells += [nbformat.v4.new_code_cell("%reset -f"), *notebook.cells]
        ends.append(len(together.cells))
    interrupt = signal.getsignal(signal.SIGINT)
    nbclient.NotebookClient(together, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    signal.signal(signal.SIGINT, interrupt)  # the client replaces it by Python's default
    for first, last in itertools.pairwise(ends):
        outputs = [output for cell in together.cells[first:last] for output in cell.get("outputs", [])]
        assert any("image/png" in output.get("data", {}) for output in outputs)
