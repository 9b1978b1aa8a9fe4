"""Expanding the xacro: the result matches the committed files, and errors in a file are named."""

from __future__ import annotations

import copy
import functools
import json
import logging
import math
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pinocchio as pin
import pytest
import yaml

from pm3dof_pin.description import expand
from pm3dof_pin.description.closures import read_closures
from pm3dof_pin.description.expand import expand_xacro, trust_xacro
from pm3dof_pin.description.robots import robot_names, robots_directory
from pm3dof_pin.exceptions import DescriptionError

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

from generate_description import description_files, same_but_rounding

Tree = dict[str, Any]
FOLDER = robots_directory() / "pm3dof_description"
XACRO = FOLDER / "xacro" / "pm3dof.urdf.xacro"
SCRIPT = Path(__file__).parents[2] / "scripts" / "generate_description.py"
_generated = functools.cache(description_files)


@pytest.fixture(scope="module")
def tree() -> Tree:
    """The chapter's parameter file as plain data."""
    data: Tree = yaml.safe_load((FOLDER / "config" / "pm3dof.yaml").read_text(encoding="utf-8"))
    return data


@pytest.fixture
def write(tree: Tree, tmp_path: Path) -> Callable[[Callable[[Tree], Any]], Path]:
    """Write the chapter's parameters after a change of the data."""

    def write_edited(edit: Callable[[Tree], Any]) -> Path:
        edited = copy.deepcopy(tree)
        edit(edited)
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump(edited), encoding="utf-8")
        return path

    return write_edited


# The committed files


@pytest.mark.parametrize("robot", robot_names())
def test_the_committed_files_are_as_generated(robot: str) -> None:
    generated = _generated(robot)
    folder = robots_directory() / f"{robot}_description"
    assert {f"urdf/{robot}.urdf", f"urdf/{robot}.closures.yaml", f"srdf/{robot}.srdf"} < set(generated)
    for name, text in generated.items():
        committed = (folder / name).read_text(encoding="utf-8")
        assert same_but_rounding(committed, text), f"{name}: run scripts/generate_description.py"
    for subfolder in {name.rpartition("/")[0] for name in generated if "/" in name} - {"urdf"}:
        there = {path.relative_to(folder).as_posix() for path in (folder / subfolder).iterdir() if path.is_file()}
        assert there <= set(generated), f"{subfolder} has files that are not generated"


def test_the_text_does_not_depend_on_where_it_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(FOLDER, tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path)
    assert expand_xacro("elsewhere/xacro/pm3dof.urdf.xacro") == expand_xacro(XACRO)


def test_the_text_says_that_it_is_generated_and_holds_no_path() -> None:
    for text in _generated("pm3dof").values():
        assert "enerated" in text
        assert str(robots_directory()) not in text


@pytest.mark.parametrize(
    ("text", "other", "same"),
    [
        ('<a xyz="0.1 2"/>', '<a xyz="0.10000000000000002 2"/>', True),
        ('<a xyz="1e-17 2"/>', '<a xyz="0.0 2"/>', True),
        ('<a xyz="0.1 2"/>', '<a xyz="0.1000001 2"/>', False),
        ('<a xyz="0.1 2"/>', '<a xyz="0.1 2 3"/>', False),
        ('<a name="x"/>', '<a name="y"/>', False),
        ("a: 1\n", "a:\n1\n", False),
    ],
)
def test_same_but_rounding(text: str, other: str, same: bool) -> None:
    assert same_but_rounding(text, other) is same


def test_the_script_checks_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    main = runpy.run_path(str(SCRIPT))["main"]
    monkeypatch.setitem(main.__globals__, "description_files", _generated)

    def run(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *arguments])
        return int(main())

    assert run("--check") == 0
    elsewhere = ("--config", str(FOLDER / "config" / "pm3dof.yaml"), "--output", str(tmp_path))
    assert run("--check", *elsewhere) == 1
    assert "not as generated" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())
    assert run(*elsewhere) == 0
    assert run("--check", *elsewhere) == 0
    assert (tmp_path / "urdf" / "pm3dof.urdf").read_bytes() == (FOLDER / "urdf" / "pm3dof.urdf").read_bytes()
    with pytest.raises(SystemExit, match="2"):
        run("--config", "x.yaml")


# Tripods with other parameters


def _quarter_turns(tree: Tree) -> None:
    """Four legs a quarter turn apart, the platform's joints 25 deg further, flatter guideways."""
    tree["name"] = "four_legs"
    tree["geometry"]["base_joint_angles"]["value"] = [10.0, 100.0, 190.0, 280.0]
    tree["geometry"]["platform_joint_angles"]["value"] = [35.0, 125.0, 215.0, 305.0]
    tree["geometry"]["guide_slope"]["value"] = 40.0
    tree["geometry"]["guide_heading"]["value"] = 170.0


def test_a_machine_with_four_legs_closes(write: Callable[..., Path], tmp_path: Path) -> None:
    for name, text in description_files(config=write(_quarter_turns)).items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text, encoding="utf-8")
    model = pin.buildModelFromUrdf(str(tmp_path / "urdf" / "four_legs.urdf"))
    assert (model.name, model.nq) == ("four_legs", 15)
    closures = read_closures(tmp_path / "urdf" / "four_legs.closures.yaml")
    assert len(closures.actuated_joints) == len(closures.closures) == 4
    pin.loadReferenceConfigurations(model, str(tmp_path / "srdf" / "four_legs.srdf"))
    data = model.createData()
    for name in ("home", "middle", "highest", "tilt_y"):
        pin.framesForwardKinematics(model, data, model.referenceConfigurations[name])
        for closure in closures.closures:
            tip, socket = (data.oMf[model.getFrameId(frame)] for frame in (closure.frame_a, closure.frame_b))
            np.testing.assert_allclose(tip.translation, socket.translation, rtol=0, atol=1e-13)


def test_configurations_out_of_reach_are_left_out_and_logged(
    write: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    config = write(lambda tree: tree["joints"]["universal_limit"].update(value=15.0))
    with caplog.at_level(logging.WARNING):
        srdf = description_files(config=config)["srdf/pm3dof.srdf"]
    assert re.findall(r'group_state name="(\w+)"', srdf) == ["home", "lowest", "middle", "highest"]
    assert re.search(r"no named configuration 'tilt_x': .*platform_x_joint", caplog.text)


def test_without_a_home_pose_there_is_no_machine(write: Callable[..., Path]) -> None:
    config = write(lambda tree: tree["geometry"]["platform_joint_angles"].update(value=[-30.0, 90.0, -120.0]))
    with pytest.raises(DescriptionError, match=r"mine\.yaml: geometry: .* do not meet one level platform"):
        description_files(config=config)


def test_links_that_are_too_short_are_refused(write: Callable[..., Path]) -> None:
    config = write(lambda tree: tree["geometry"]["link_length"].update(value=120.0))
    with pytest.raises(DescriptionError, match=r"mine\.yaml: geometry: .* do not reach the level platform"):
        description_files(config=config)


# Bad files


@pytest.mark.parametrize(
    ("section", "name"), [("geometry", "guide_slope"), ("inertia", "cross_moment"), ("drawing", "tool_radius")]
)
def test_a_missing_number_is_named(write: Callable[..., Path], section: str, name: str) -> None:
    config = write(lambda tree: tree[section].pop(name))
    said = rf"mine\.yaml: {section}\.{name}: is missing; expected value, unit, status and source$"
    with pytest.raises(DescriptionError, match=said):
        description_files(config=config)
    with pytest.raises(DescriptionError, match=said):
        expand_xacro(XACRO, {"config": str(config)})


def test_a_number_that_is_none_is_refused(write: Callable[..., Path]) -> None:
    config = write(lambda tree: tree["inertia"]["base_mass"].update(value=math.nan))
    with pytest.raises(DescriptionError, match=r"mine\.yaml: inertia\.base_mass\.value: expected a finite number"):
        description_files(config=config)
    with pytest.raises(DescriptionError, match="<mass>: expected finite numbers, not 'nan'"):
        expand_xacro(XACRO, {"config": str(config)})


def test_an_unknown_unit_is_refused(write: Callable[..., Path]) -> None:
    config = write(lambda tree: tree["drawing"]["tool_radius"].update(unit="inch"))
    with pytest.raises(DescriptionError, match=r"drawing\.tool_radius\.unit: expected one of .*not 'inch'"):
        description_files(config=config)
    with pytest.raises(DescriptionError, match=r"drawing\.tool_radius\.unit: unknown unit inch"):
        expand_xacro(XACRO, {"config": str(config)})


@pytest.mark.parametrize("name", [None, 7])
def test_a_machine_needs_a_name(write: Callable[..., Path], name: Any) -> None:
    config = write(lambda tree: tree.update(name=name))
    with pytest.raises(DescriptionError, match=r"mine\.yaml: name: expected the name of the robot"):
        description_files(config=config)


def test_guideways_must_rise(write: Callable[..., Path]) -> None:
    def flat(tree: Tree) -> None:
        tree["geometry"]["guide_slope"]["value"] = 0.0
        tree["geometry"]["base_radius"]["value"] = 500.0

    with pytest.raises(DescriptionError, match=r"geometry\.guide_slope: expected guideways that rise"):
        description_files(config=write(flat))


def test_a_missing_parameter_file_is_named() -> None:
    with pytest.raises(DescriptionError, match=r"/nowhere/mine\.yaml"):
        expand_xacro(XACRO, {"config": "/nowhere/mine.yaml"})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "No such file or directory"),
        ("<robot name='x'>", "expected XML.*no element found: line 1"),
        ("<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:arm/></robot>", "unknown macro name: xacro:arm"),
        ("<robot name='${1 / 0}'/>", "division by zero when evaluating expression '1 / 0'"),
    ],
)
def test_what_is_no_xacro_is_refused(tmp_path: Path, text: str | None, said: str) -> None:
    path = tmp_path / "arm.xacro"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError, match=said) as caught:
        expand_xacro(path)
    assert caught.value.path == path


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("${(lambda: ().__class__.__base__)()}", "'__base__' in .* is not allowed"),
        ("${'%s'.format(1)}", "'format' in .* is not allowed"),
        ("${(x for x in [1]).gi_frame}", "'gi_frame' in .* is not allowed"),
        ("$(eval 1 .__class__)", "'__class__' in .* is not allowed"),
        ("${python.vars(list)}", "'vars'"),
        ("${xacro.load_yaml('/etc/passwd')}", "it reads /etc/passwd, which is not in"),
        ("$(env HOME)", "environment variable 'HOME' is not set"),
        ("$(find elsewhere)", "no package 'elsewhere' in .* \\(--package-path adds a folder\\)"),
        ("$(arg mass)", "Undefined substitution argument mass, which has no default: --xacro-arg"),
        ("${len([0] * 10 ** 10)}", "GiB of memory"),
        ("${xacro.load_yaml('outside.yaml')}", "it reads .*outside.yaml, which is not in"),
    ],
)
def test_a_xacro_from_others_may_do_little(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "secret.yaml").write_text("a: 1", encoding="utf-8")
    folder = tmp_path / "arm"
    folder.mkdir()
    (folder / "outside.yaml").symlink_to(tmp_path / "secret.yaml")
    path = folder / "arm.urdf.xacro"
    robot = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="{}"/></robot>'
    path.write_text(robot.format(content), encoding="utf-8")
    with pytest.raises(DescriptionError, match=said):
        expand_xacro(path)


def test_a_xacro_reads_its_package_and_those_it_is_given(tmp_path: Path) -> None:
    folder = tmp_path / "arm_description" / "xacro"
    folder.mkdir(parents=True)
    (folder.parent / "package.xml").write_text("<package/>", encoding="utf-8")
    (folder.parent / "sizes.yaml").write_text("length: 0.25", encoding="utf-8")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "common.xacro").write_text('<robot><link name="common"/></robot>', encoding="utf-8")
    path = folder / "arm.urdf.xacro"
    path.write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find parts)/common.xacro"/>'
        "<link name=\"l${xacro.load_yaml('../sizes.yaml').length}\"/></robot>",
        encoding="utf-8",
    )
    with pytest.raises(DescriptionError, match="no package 'parts'"):
        expand_xacro(path)
    text = expand_xacro(path, package_paths=[tmp_path])
    assert '<link name="common" />' in text
    assert '<link name="l0.25" />' in text
    (tmp_path / "parts").rename(tmp_path / "renamed")
    (tmp_path / "renamed" / "package.xml").write_text("<package><name>parts</name></package>", encoding="utf-8")
    assert expand_xacro(path, package_paths=[tmp_path / "renamed"]) == text


def test_an_expansion_that_ends_early_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes too long, is killed, cannot be started, or expands a short file too far."""
    path = tmp_path / "arm.xacro"
    path.write_text('<robot name="arm"><link name="l"/></robot>', encoding="utf-8")
    slow = subprocess.TimeoutExpired("python", 15)
    killed, failed = (subprocess.CompletedProcess([], status, "", "a\nMemoryError") for status in (-9, 1))
    huge = subprocess.CompletedProcess([], 0, json.dumps({"texts": [" " * (expand.MAX_BYTES + 1)]}), "")
    for ending, said in (
        (slow, "takes more than 15 s"),
        (OSError("no more processes"), "in a separate process .no more processes"),
        (killed, "expansion aborted: too much time or memory"),
        (failed, "expansion aborted: MemoryError"),
        (huge, "MiB when expanded"),
    ):
        monkeypatch.setattr(expand.subprocess, "run", Mock(side_effect=[ending]))
        with pytest.raises(DescriptionError, match=said):
            expand_xacro(path)


def test_of_files_expanded_together_the_wrong_one_is_named(tmp_path: Path) -> None:
    good, bad = (tmp_path / f"{name}.xacro" for name in ("good", "bad"))
    good.write_text("<robot name='good'/>", encoding="utf-8")
    bad.write_text("<robot xmlns:xacro='http://www.ros.org/wiki/xacro' name='${1 / 0}'/>", encoding="utf-8")
    assert [text.count('name="good"') for text in expand.expand_together([good, good], {})] == [1, 1]
    with pytest.raises(DescriptionError, match="division by zero") as caught:
        expand.expand_together([good, bad, good], {})
    assert caught.value.path == bad


def test_a_trusted_xacro_may_do_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OF_MINE", "forearm")
    path = tmp_path / "arm.xacro"
    path.write_text('<robot name="arm"><link name="$(env OF_MINE)"/></robot>', encoding="utf-8")
    trust_xacro()
    try:
        assert '<link name="forearm" />' in expand_xacro(path)
    finally:
        trust_xacro(False)
    with pytest.raises(DescriptionError, match="'OF_MINE' is not set"):
        expand_xacro(path)


def test_characters_that_xml_does_not_have_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bell.urdf.xacro"
    root = '<robot name="bell" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    path.write_text(root + """<link name="${'a' + '\\x07'}"/></robot>""")
    with pytest.raises(DescriptionError, match=r"bell\.urdf\.xacro: xacro: expands to what is not XML"):
        expand_xacro(path)
