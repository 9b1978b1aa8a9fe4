"""Examples in README.md and the documentation are run, and their output is compared with the one shown.

On every page, in order:

- ```` ```console ```` blocks: lines that start with `$ ` are commands of the package, run in this process, the lines
  below them their output (standard output and standard error, as on a terminal 100 columns wide);
- ```` ```python ```` blocks form one program per page; a ```` ```output ```` block after one is its output.

Whitespace is normalised, and `...` matches anything. A number may differ from the one shown by one in its last digit,
as results do between machines, or by the tolerance of the block: ```` ```output within 5 % ````, for results that
depend on many roundings. A ```` ```{code-block} ```` with a caption is a file of that name. Numbers below 1e-9 are all
equal to zero. ```` ```bash ```` blocks are not run.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from pm3dof_pin.cli.stiffness_map import PICTURES
from pm3dof_pin.maps.quantities import QUANTITIES

ROOT = Path(__file__).parents[2]
DOCS = [page for page in sorted((ROOT / "docs").rglob("*.md")) if not {"_build", "generated"} & {*page.parts}]
PAGES = [ROOT / "README.md", *DOCS]
BLOCK = re.compile(r"^```(console|python|output)(?: within (\S+) %)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"^```\{code-block\} \w+\n:caption: (\S+)\n\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])[-+\u2212]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")
COMPUTED_PICTURES = {
    "atlas_chapter_global.png",
    "atlas_condition_number.png",
    "error_map_tip_rms.png",
    "error_map_uncompensable_rms.png",
    "error_ranking.png",
    "hexapod_first_frequency.png",
    "hexapod_workspace.png",
    "figure_8_1_schematic.png",
    "figure_8_2_workspace.png",
    "figure_8_5_pseudo_error.png",
    "figure_8_6_compensation_flow.png",
    "critical_springs.png",
    "universal_joint.png",
    "passive_leg_radius.png",
    *PICTURES,
}
LIKE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@dataclass
class Block:
    kind: str
    allowed: float
    text: str
    line: int


def _blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [
        Block(m[1], float(m[2] or 0.0) / 100.0, m[3], text.count("\n", 0, m.start()) + 1) for m in BLOCK.finditer(text)
    ]


def _write_files(page: Path, folder: Path) -> None:
    """Write the files that a page shows, so that its examples find them."""
    for name, text in FILE.findall(page.read_text(encoding="utf-8")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def _alike(expected: str, got: str, allowed: float) -> bool:
    """Return whether two numbers are considered equal."""
    a, b = (float(text.replace("\u2212", "-")) for text in (expected, got))
    mantissa, _, exponent = expected.lower().partition("e")
    last = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    is_count = last >= 1.0 and not exponent
    slack = allowed * abs(a) + (0.0 if is_count and not allowed else 1.001 * last)
    return abs(a - b) <= slack or max(abs(a), abs(b)) < 1e-9


def _matches(expected: str, got: str, allowed: float) -> bool:
    """Return whether the output is as expected, apart from whitespace, `...` and the last digits of numbers."""
    if doctest.OutputChecker().check_output(expected, got, LIKE):
        return True
    there, printed = ([NUMBER.findall(part) for part in text.split("...")] for text in (expected, got))
    if len(there) == 2 and len(there[0]) + len(there[1]) <= len(printed[0]):  # numbers before `...` and after
        printed = [printed[0][: len(there[0])], printed[0][len(printed[0]) - len(there[1]) :]]
    if [len(part) for part in there] != [len(part) for part in printed]:
        return False
    if not all(_alike(a, b, allowed) for part in zip(there, printed, strict=True) for a, b in zip(*part, strict=True)):
        return False
    return doctest.OutputChecker().check_output(NUMBER.sub("#", expected), NUMBER.sub("#", got), LIKE)


def _compare(page: Path, block: Block, expected: str, got: str) -> None:
    if not _matches(expected, got, block.allowed):
        pytest.fail(f"{page.relative_to(ROOT)}:{block.line}: expected\n{expected}\ngot\n{got}", pytrace=False)


@pytest.mark.parametrize(
    ("expected", "got", "allowed", "same"),
    [
        ("12.34 µm", "12.35 µm", 0.0, True),
        ("12.34 µm", "12.37 µm", 0.0, False),
        ("7 springs", "8 springs", 0.0, False),
        ("loops closed to 4e-17 m", "loops closed to 0e+00 m", 0.0, True),
        ("tip 412 µm", "tip 425 µm", 0.05, True),
        ("tip 412 µm", "tip 452 µm", 0.05, False),
        ("1.00e6 N/m", "1.00e7 N/m", 0.0, False),
        ("u1 0.2571", "u2 0.2571", 0.0, False),
        ("-15.000", "15.000", 0.0, False),
        ("u 0.257 ... z 0.5", "u 0.258 and 3 more, z 0.5", 0.0, True),
        ("u 0.257 ... z 0.5", "u 0.357 and 3 more, z 0.5", 0.0, False),
        ("u 0.257 ... z 0.5", "u 0.257 and 3 more, z 0.7", 0.0, False),
    ],
)
def test_numbers_may_differ_in_their_last_digit(expected: str, got: str, allowed: float, same: bool) -> None:
    assert _matches(expected, got, allowed) is same


def _with(kind: str) -> list[Any]:
    return [
        pytest.param(page, id=str(page.relative_to(ROOT)))
        for page in PAGES
        if any(block.kind == kind for block in _blocks(page))
    ]


@pytest.mark.parametrize("page", _with("python"))
def test_python_examples(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for tool in re.findall(r"^(?:import|from) (mujoco|pybullet|pydrake)", page.read_text(), flags=re.MULTILINE):
        pytest.importorskip(tool)  # not every Python has a wheel of each
    monkeypatch.chdir(tmp_path)
    _write_files(page, tmp_path)
    namespace: dict[str, Any] = {"__name__": "__example__"}
    printed = ""
    for block in _blocks(page):
        if block.kind == "python":
            output = io.StringIO()
            # leading blank lines, so that a traceback names the line of the page
            code = compile("\n" * block.line + block.text, str(page), "exec")
            with contextlib.redirect_stdout(output):
                exec(code, namespace)
            printed = output.getvalue()
        elif block.kind == "output":
            _compare(page, block, block.text, printed)
    for name in [name for name, known in QUANTITIES.items() if known.compute.__module__ == "__example__"]:
        del QUANTITIES[name]  # other pages do not have it


@pytest.mark.usefixtures("unpainted", "report_without_pictures")
@pytest.mark.parametrize("page", _with("console"))
def test_console_examples(page: Path, run: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}.items():
        monkeypatch.setenv(name, value)
    _write_files(page, tmp_path)
    for block in _blocks(page):
        if block.kind != "console":
            continue
        for session in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
            command, _, expected = session.partition("\n")
            program, *arguments = shlex.split(command)
            assert program in ("pm3dof", "python"), f"only commands of the package are run here, not {program}"
            if program == "pm3dof":
                printed = run(*arguments, cwd=tmp_path, merged=True).stdout
            else:
                printed = _python(arguments, tmp_path)
            _compare(page, block, expected, printed)


def _python(arguments: list[str], folder: Path) -> str:
    return subprocess.run(
        [sys.executable, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        cwd=folder,
        check=False,
    ).stdout


def test_every_command_is_documented() -> None:
    from pm3dof_pin.cli.app import COMMANDS

    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS if page.parent.name == "commands")
    for command in COMMANDS:
        assert f"$ pm3dof {command}" in pages, f"no page in docs/commands shows `pm3dof {command}`"


def test_no_page_is_long() -> None:
    """Whoever looks for one answer reads one page. The chapter's own pages follow the chapter."""
    for page in DOCS:
        words = len(page.read_text(encoding="utf-8").split())
        assert words <= 2300 or page.stem in ("theory", "chapter_statements"), f"{page.name}: {words} words"


def test_every_room_is_in_the_api() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS if page.parent.name == "api")
    listed = " ".join(re.findall(r"^```\{modules\} (.+)$", pages, re.MULTILINE)).split()
    rooms = {path.stem for path in (ROOT / "pm3dof_pin").iterdir() if path.suffix == ".py" or path.is_dir()}
    for room in rooms - {"cli", "robots"}:
        assert room.startswith("_") or f"pm3dof_pin.{room}" in listed, f"docs/api has no page with pm3dof_pin.{room}"


def test_every_page_is_reached() -> None:
    listed = {
        (page.parent / re.sub(r".*<(.+)>", r"\1", entry)).resolve()
        for page in DOCS
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        for entry in tree.split("\n")
        if entry and not entry.startswith(":") and not entry.endswith("*")  # a pattern, for generated pages
    }
    assert {page.with_suffix("") for page in DOCS} - {ROOT / "docs" / "index"} == listed


def test_the_readme_has_one_command_for_the_job_and_one_for_the_tests() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = [block for block in re.findall(r"^```bash\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)]
    assert all(command.count("\n") == 1 for command in commands)
    assert [("stiffness-map" in command, "pytest" in command) for command in commands] == [(True, False), (False, True)]


def test_pictures_exist() -> None:
    picture = re.compile(r"!\[[^\]]*\]\(([^)]+)\)|```\{(?:image|figure)\} (\S+)|<img src=\"([^\"]+)\"")
    for page in [*PAGES, *sorted((ROOT / "robots").rglob("*.md"))]:
        for match in picture.finditer(page.read_text(encoding="utf-8")):
            path = page.parent / match[match.lastindex or 0]
            if path.parent.name == "computed":  # drawn when the documentation is built
                assert path.name in COMPUTED_PICTURES
                continue
            assert path.is_file(), f"{page.relative_to(ROOT)} shows {path}, which does not exist"
