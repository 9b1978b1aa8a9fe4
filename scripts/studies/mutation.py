"""Mutation tests: which introduced mistakes do the tests notice?

Each mutant is a copy of the package with one operator, comparison, number or sign changed in one module; the tests of
that module run over it and should fail. Survivors are printed, to be explained (CONTRIBUTING.md) or caught by a new
test. All modules take hours, so this is not part of the checks: the default is a sample of each module.

    python scripts/studies/mutation.py [MODULE ...] [--count 10] [--seed 1]
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "pm3dof_pin"
SECONDS = 600

MODULES = {
    "description/inertia_checks.py": ["mechanism/test_description_checks.py"],
    "description/physical_bounds.py": ["mechanism/test_description_checks.py"],
    "description/own_files.py": ["export/test_meshes.py"],
    "kinematics/units.py": ["kinematics/test_units.py"],
    "kinematics/assembly.py": ["mechanism/test_assembly.py"],
    "kinematics/singularity.py": ["mechanism/test_singularity.py"],
    "kinematics/actuation.py": ["mechanism/test_actuation.py"],
    "chapter/kinematics.py": ["chapter/test_kinematics.py", "chapter/test_limits.py"],
    "chapter/direct_kinematics.py": ["chapter/test_direct_kinematics.py"],
    "dynamics/beam_masses.py": ["elastic/test_shear_and_mass.py"],
    "dynamics/mass_matrix.py": ["dynamics/test_inverse_dynamics.py", "dynamics/test_free_vibration.py"],
    "dynamics/inverse_dynamics.py": ["dynamics/test_inverse_dynamics.py"],
    "dynamics/modes.py": ["dynamics/test_modes.py"],
    "dynamics/statics.py": ["dynamics/test_statics.py"],
    "elastic/springs.py": ["elastic/test_springs.py", "elastic/test_beams.py", "elastic/test_shear_and_mass.py"],
    "elastic/elastic_model.py": ["elastic/test_beams.py", "elastic/test_shear_and_mass.py"],
    "elastic/virtual_joints.py": [
        "elastic/test_virtual_joints.py",
        "elastic/test_springs.py",
        "elastic/test_shear_and_mass.py",
    ],
    "elastic/report.py": ["elastic/test_condensation.py", "elastic/test_beams.py"],
    "elastic/indices.py": ["elastic/test_indices.py"],
    "elastic/bow.py": ["elastic/test_flexures.py"],
    "errors/pose_error.py": ["errors/test_pose_error.py"],
    "errors/normal_vectors.py": ["errors/test_normal_vectors.py"],
    "errors/thermal_growth.py": ["errors/test_thermal_growth.py"],
    "errors/waviness.py": ["errors/test_error_budget.py", "simulation/test_error_sources.py"],
    "errors/source_errors.py": ["errors/test_error_budget.py", "errors/test_thermal_growth.py"],
    "errors/tool_errors.py": ["errors/test_error_map.py", "errors/test_error_budget.py"],
    "errors/tolerances.py": ["errors/test_tolerances.py"],
    "errors/vibration.py": ["errors/test_vibration.py"],
    "simulation/simulated_machine.py": ["simulation/test_error_sources.py", "errors/test_thermal_growth.py"],
    "calibration/identification.py": ["measuring/test_nuisances.py", "calibration/test_identification.py"],
    "calibration/linearisation.py": ["calibration/test_identification.py"],
    "export/robot_document.py": ["export/test_closure_types.py", "export/test_mujoco.py", "export/test_sdf.py"],
    "export/mjcf.py": ["export/test_mujoco.py"],
    "viewer/server.py": ["viewer/test_server.py"],
}
"""Tests of each module, below tests/."""

_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}


def mutants(source: str) -> Iterator[tuple[int, str, str]]:
    """Yield every mutant of a module: line, what was changed, and the text."""
    tree = ast.parse(source)
    for index, node in enumerate(ast.walk(tree)):
        for before, after in _changes(node):
            mutated = copy.deepcopy(tree)
            place = next(entry for k, entry in enumerate(ast.walk(mutated)) if k == index)
            for name, value in vars(after).items():
                setattr(place, name, value)
            yield getattr(node, "lineno", 0), f"{before} -> {ast.unparse(after)}", ast.unparse(mutated)


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield changes of a node: its text, and the node changed."""
    changed = copy.deepcopy(node)
    if isinstance(changed, ast.BinOp) and type(changed.op) in _OPERATORS:
        before = ast.unparse(changed)
        changed.op = _OPERATORS[type(changed.op)]()  # type: ignore[assignment]
        yield before, changed
    elif isinstance(changed, ast.BinOp) and isinstance(changed.op, ast.MatMult):
        before = ast.unparse(changed)
        changed.left, changed.right = changed.right, changed.left
        yield before, changed
    elif isinstance(changed, ast.BoolOp):
        before = ast.unparse(changed)
        changed.op = _OPERATORS[type(changed.op)]()  # type: ignore[assignment]
        yield before, changed
    elif isinstance(changed, ast.Compare) and len(changed.ops) == 1 and type(changed.ops[0]) in _OPERATORS:
        before = ast.unparse(changed)
        changed.ops = [_OPERATORS[type(changed.ops[0])]()]  # type: ignore[list-item]
        yield before, changed
    elif isinstance(changed, ast.Constant) and type(changed.value) in (int, float):
        before = ast.unparse(changed)
        changed.value = changed.value * 3 + 1
        yield before, changed
    elif isinstance(changed, ast.Call) and len(changed.args) == 2 and not changed.keywords:
        before = ast.unparse(changed)
        changed.args = changed.args[::-1]
        yield before, changed


def passes(module: str, text: str, tests: list[str]) -> bool:
    """Run a module's tests over a copy of the package with a changed text of it, and say whether all pass."""
    with tempfile.TemporaryDirectory(prefix="planted_") as folder:
        shutil.copytree(ROOT / PACKAGE, Path(folder) / PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("robots", "tests", "pyproject.toml"):
            (Path(folder) / name).symlink_to(ROOT / name)
        (Path(folder) / PACKAGE / module).write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
        command += [f"tests/{test}" for test in tests]
        environment = os.environ | {"PYTHONPATH": folder}
        try:
            done = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, timeout=SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            return False
        return done.returncode == 0


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="*", metavar="MODULE", default=list(MODULES))
    parser.add_argument("--count", type=int, default=10, help="mutants of each module, at random")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for module in options.modules:
        source = (ROOT / PACKAGE / module).read_text(encoding="utf-8")
        if not passes(module, source, MODULES[module]):
            sys.exit(f"{module}: its tests fail without any mutation")
        every = list(mutants(source))
        chosen = random.Random(options.seed).sample(every, min(options.count, len(every)))
        survivors = []
        for line, what, text in chosen:
            if passes(module, text, MODULES[module]):
                survivors.append(what)
                print(f"  survives: {module}:{line}: {what}", flush=True)
        print(f"{module}: {len(chosen) - len(survivors)} of {len(chosen)} noticed ({len(every)} in all)", flush=True)


if __name__ == "__main__":
    main()
