"""Programs cached on disk: found, rebuilt when damaged, and not needed if nothing can be written."""

from __future__ import annotations

import gc
import itertools
import os
import stat
import subprocess
import sys

import numpy as np
import pytest

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.programs import cache, llvm
from pm3dof_pin.programs.graph import Graph, sqrt


def make(factor=2.0):
    graph = Graph()
    x = graph.input("x", [1.0])
    return graph.program("f", {"y": sqrt(x) * factor})


@pytest.fixture
def folder(tmp_path, monkeypatch):
    path = tmp_path / "kept"
    monkeypatch.setenv("PM3DOF_CACHE_DIR", str(path))
    return path


@pytest.fixture
def compilations(monkeypatch):
    """Programs that were compiled, not loaded."""
    done = []
    original = llvm.object_code
    monkeypatch.setattr(
        llvm, "object_code", lambda program, *options: done.append(program) or original(program, *options)
    )
    return done


def value(program):
    return cache.compiled(program)([[9.0]])[0, 0]


def test_a_program_is_compiled_once(folder, compilations):
    assert value(make()) == 6.0
    assert value(make()) == 6.0
    assert value(make(3.0)) == 9.0
    assert len(compilations) == 2
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert len(list(folder.iterdir())) == 2


def test_what_is_only_read_is_not_compiled(folder, compilations):
    program = cache.known("a root", make)
    assert program.program.evaluate([[9.0]])[0, 0] == 6.0
    assert not compilations
    assert program([[9.0], [4.0]]).tolist() == [[6.0], [4.0]]
    assert len(compilations) == 1


def test_code_that_is_made_late_says_so_if_it_cannot_be_made(folder, monkeypatch):
    def failing(program, lanes, careful):
        raise ProgramError("no memory left")

    monkeypatch.setattr(llvm, "object_code", failing)
    program = cache.known("another root", make)
    with pytest.raises(ProgramError, match="no memory left"):
        program([[9.0]])


def test_no_garbage_is_looked_for_while_a_program_is_recorded(folder):
    looked = []

    def recording():
        looked.append(gc.isenabled())
        return make()

    cache.stored("a recording", recording)
    with pytest.raises(ZeroDivisionError):
        cache.stored("a failure", lambda: 1 // 0)
    assert [*looked, gc.isenabled()] == [False, True]


def test_long_programs_are_refused_before_they_are_compiled(folder, compilations, monkeypatch):
    monkeypatch.setattr(cache, "MOST_OPERATIONS", 1)
    with pytest.raises(ProgramError, match="2 operations"):
        value(make())
    assert not compilations


def test_code_that_runs_for_long_is_optimised(folder, compilations, monkeypatch):
    """Optimised code replaces the first, gives the same bits, and is the one loaded later."""
    monkeypatch.setattr(llvm, "WORTH_OPTIMISING", 100 * llvm._SECONDS_EACH)
    inputs = np.random.default_rng(8).uniform(0.0, 10.0, size=(60, 1))
    program = cache.compiled(make(3.7))
    outputs = program(inputs)
    assert len(compilations) == 1
    assert np.array_equal(program(inputs), outputs)
    assert len(compilations) == 2
    again = cache.compiled(make(3.7))
    assert np.array_equal([again(inputs) for _ in range(3)], [outputs] * 3)
    assert len(compilations) == 2


def test_waiting_for_a_processor_is_no_reason_to_optimise(folder, compilations, monkeypatch):
    hours = itertools.count(step=3600.0)
    monkeypatch.setattr(llvm, "WORTH_OPTIMISING", 60.0)
    monkeypatch.setattr(llvm.time, "perf_counter", lambda: next(hours))
    program, inputs = cache.compiled(make(3.7)), np.full((60, 1), 2.0)
    assert np.array_equal(program(inputs), program(inputs))
    assert len(compilations) == 1


def test_what_cannot_be_compiled_with_care_goes_on_without(folder, monkeypatch):
    original = llvm.object_code

    def quickly_only(program, lanes, careful):
        if careful:
            raise ProgramError("no memory left")
        return original(program, lanes, careful)

    monkeypatch.setattr(llvm, "WORTH_OPTIMISING", 100 * llvm._SECONDS_EACH)
    monkeypatch.setattr(llvm, "object_code", quickly_only)
    inputs = np.random.default_rng(8).uniform(0.0, 10.0, size=(60, 1))
    program = cache.compiled(make(3.7))
    outputs = program(inputs)
    assert np.array_equal([program(inputs) for _ in range(2)], [outputs] * 2)


def test_code_that_cannot_be_loaded_is_made_again(folder, compilations, monkeypatch):
    cache.compiled(make(3.7))
    loads = []
    original = llvm.Compiled._load

    def failing_once(self, code):
        loads.append(code)
        if len(loads) == 1:
            raise ProgramError("made elsewhere")
        original(self, code)

    monkeypatch.setattr(llvm.Compiled, "_load", failing_once)
    assert cache.compiled(make(3.7))(np.full((1, 1), 2.0)).shape == (1, 1)
    assert len(compilations) == 2


def test_a_program_is_traced_once(folder):
    traced = []

    def trace():
        traced.append(make())
        return traced[-1]

    programs = [cache.stored("robot", trace) for _ in range(3)]
    cache.stored("another robot", trace)
    assert len(traced) == 2
    assert {program.key for program in programs} == {make().key}
    assert programs[2].lines == make().lines


def test_the_first_of_two_that_record_at_once_decides(folder):
    """Both run the same program, whatever variant of a machine each recorded it from."""

    def slower():
        cache.stored("robot", make)  # another process, meanwhile
        return make(3.0)

    assert cache.stored("robot", slower).key == make().key
    assert cache.stored("robot", lambda: pytest.fail("recorded again")).key == make().key


def test_other_sources_have_other_entries(folder, compilations, monkeypatch):
    value(make())
    cache.stored("robot", make)
    # an edit outside programs/: traced again, but the same machine code
    own = cache._sources("programs")
    monkeypatch.setattr(cache, "_sources", lambda room: own if room else "another version")
    traced = []
    value(cache.stored("robot", lambda: traced.append(1) or make()))
    assert len(traced) == len(compilations) == 1
    monkeypatch.setattr(cache, "_sources", lambda room: "another version")
    value(make())
    assert len(compilations) == 2


@pytest.mark.parametrize(
    "damage", [lambda entry: entry[:-1], lambda entry: b"", lambda entry: entry[:40] + b"x" + entry[41:]]
)
def test_what_is_damaged_is_made_again(folder, compilations, damage):
    value(make())
    cache.stored("robot", make)
    for path in folder.iterdir():
        path.write_bytes(damage(path.read_bytes()))
    assert value(cache.stored("robot", make)) == 6.0
    assert len(compilations) == 2
    assert value(cache.stored("robot", lambda: pytest.fail("traced again"))) == 6.0
    assert len(compilations) == 2


def test_oldest_entries_make_room(folder, monkeypatch):
    for k in range(4):
        cache.stored(str(k), make)
        (newest,) = {path for path in folder.iterdir() if path.stat().st_mtime > 1e9}
        os.utime(newest, (k, k))
        size = newest.stat().st_size
    cache.stored("0", lambda: pytest.fail("0 is there"))  # now the most recently used
    monkeypatch.setattr(cache, "LARGEST", 3 * size + size // 2)
    cache.stored("4", make)
    remaining = []
    for k in ("0", "3", "4"):
        cache.stored(k, lambda k=k: pytest.fail(f"{k} is gone"))
    cache.stored("1", lambda: remaining.append(1) or make())
    assert remaining == [1]


def test_without_a_folder(tmp_path, monkeypatch, compilations):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    for named in (str(blocked), str(blocked / "below"), ""):
        monkeypatch.setenv("PM3DOF_CACHE_DIR", named)
        assert value(cache.stored("robot", make)) == 6.0
    assert len(compilations) == 3
    assert blocked.read_text() == "no folder"


def test_a_folder_others_may_write_to_is_not_used(folder, compilations):
    folder.mkdir()
    folder.chmod(0o777)
    assert value(make()) == 6.0
    assert list(folder.iterdir()) == []


def test_somebody_elses_folder_is_not_used(folder, monkeypatch, compilations):
    value(make())
    monkeypatch.setattr(os, "getuid", lambda: folder.stat().st_uid + 1)
    assert value(make()) == 6.0
    assert len(compilations) == 2


def test_place_of_the_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("PM3DOF_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "shared"))
    assert cache._folder() == tmp_path / "shared" / "pm3dof-pin"
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert cache._folder() == tmp_path / ".cache" / "pm3dof-pin"


def test_another_process_loads_the_same_bits(folder):
    inputs = np.random.default_rng(7).uniform(0.0, 10.0, size=(20, 1))
    outputs = cache.compiled(make(3.7))(inputs)
    code = f"""
import numpy as np
from pm3dof_pin.programs import cache, llvm
from pm3dof_pin.programs.graph import Graph, sqrt
llvm.object_code = None
graph = Graph()
program = graph.program("f", {{"y": sqrt(graph.input("x", [1.0])) * 3.7}})
print(cache.compiled(program)(np.array({inputs.tolist()})).tobytes().hex())
"""
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert bytes.fromhex(printed.stdout) == outputs.tobytes()
