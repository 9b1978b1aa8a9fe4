"""A robot's quantities as functions for other people's code: one Python file that is batched and differentiable, or C.

The quantities are those of :mod:`pm3dof_pin.export.function_quantities`.

Loops are closed by the recorded Newton steps, along a straight line from home in a fixed number of legs, so that every
pose of a batch does the same. Derivatives are those of two more steps at the solution: a Newton step of a root x(y) has
the derivative of x, whatever it starts from, and two of them also the second.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from pm3dof_pin.arrays import require_choice
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError, ProgramError, SingularConfigurationError
from pm3dof_pin.export.c_kinematics import c_files
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.export.function_quantities import KINEMATICS, Described, all_quantities, describe_quantity
from pm3dof_pin.export.template import docstring
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.shared_commands import AGREEING
from pm3dof_pin.kinematics.units import coordinate_periods, coordinate_scales
from pm3dof_pin.programs.array_code import IMPORTS, Library, array_code
from pm3dof_pin.programs.c import c99, number
from pm3dof_pin.programs.walk import WALK, Walk
from pm3dof_pin.typing import Array, Matrix, Vector

Target: TypeAlias = Literal[Library, "c"]
"""What functions are written for."""

_LEGS = (1, 2, 4, 8, 16, 32, 64)
_STEPS = 3  # in a leg
_LAST_STEPS = 6  # at the end
_POSES, _GOLDEN, _SEED = 200, 6, 3
_CLOSED = 1e-10  # closure error after all legs, from which two steps reach rounding [m, rad]
_ACCEPTED = 1e-9  # of answers [m, rad]


def export_functions(robot: Robot, of: Sequence[str], to: Target, folder: Path | str) -> list[Path]:
    """Write quantities of a robot as functions.

    Example:
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.export.functions import export_functions
        >>> [file.name for file in export_functions(pm.load("pm3dof"), ["commands"], "numpy", "functions")]
        ['pm3dof_numpy.py']

    Args:
        robot: the robot.
        of: the quantities: those of :mod:`pm3dof_pin.export.function_quantities`; Jacobians "A_by_B", and
            "A_by_B_derivatives", A and B as in :func:`~pm3dof_pin.kinematics.jacobians.jacobian`; or "all".
        to: the library, or "c": the kinematics as :func:`~pm3dof_pin.export.controllers.export_controller` writes
            them, and a function of q for each other quantity.
        folder: output folder, created if missing.

    Returns:
        The files written.

    Raises:
        InvalidValueError: an unknown quantity or library, or a robot without drives, springs or tool for one.
        ProgramError: there is no program for the robot, or straight lines from home do not reach its poses.
        ConvergenceError: the loops do not close at home.
        OutputError: a file cannot be written.
    """
    require_choice("to", to, Target)
    described: dict[str, Described] = {}
    names = list(dict.fromkeys(of))
    if not names:
        raise InvalidValueError("of", "none", "at least one quantity")
    if robot.tool_frame is None and "transform" in names:
        raise InvalidValueError(robot.name, problem="has no tool frame", expected="one for transform")
    controller = _controller(robot)  # what has none is refused before long work
    if names == ["all"]:
        described = dict(all_quantities(robot))
        names = [*(name for name in KINEMATICS if name != "transform" or robot.tool_frame is not None), *described]
    described |= {name: describe_quantity(robot, name) for name in names if name not in (*KINEMATICS, *described)}
    if invalid := [name for name in described if not name.isidentifier()]:
        raise InvalidValueError("of", invalid[0], "a quantity that can be the name of a function")
    if to == "c":
        files = c_files(controller)
        if described:
            poses = reachable_poses(robot, _GOLDEN, np.random.default_rng(_SEED))
            files |= {
                f"{controller.name}_{name}.c": _c(controller, name, each, poses) for name, each in described.items()
            }
    else:
        files = {f"{controller.name}_{to}.py": _module(controller, names, described, to)}
    return [write_text_atomically(Path(folder) / name, text) for name, text in files.items()]


def _controller(robot: Robot) -> Controller:
    try:
        return Controller(robot)
    except ProgramError as error:
        advice = "functions are printed from programs; in Python, Robot.solve, Robot.forward and pm.jacobian do without"
        raise ProgramError(f"{error}: {advice} (engine='pinocchio')") from error


def _c(controller: Controller, name: str, each: Described, poses: Poses) -> str:
    """Return the function of a quantity at q in C, and its test."""
    robot, function = controller.robot, f"{controller.name}_{name}"
    chosen = robot.solve(poses.coordinates, guess=poses.q, engine="pinocchio")
    rows, values = _referred(robot, name, each, chosen)
    size = values[0].size
    program = dataclasses.replace(each.program, name=function)
    text = c99(
        program,
        summary=f"{each.text[0].upper()}{each.text[1:]}, of {robot.name} at q, as {controller.name}_state has it.",
        descriptions={"sound": "1 if the values hold, else 0"},
        parameters=each.parameters,
    )
    lines = [text]
    for word, table in (("golden_q", chosen.q[rows]), ("golden", values)):
        lines.append(f"static const double {function}_{word}[{len(table) * table[0].size}] = {{")
        lines += [f"  {', '.join(number(value) for value in row.ravel().tolist())}," for row in table]
        lines += ["};", ""]
    filled = {
        "@NAME@": function,
        "@NQ@": str(robot.model.nq),
        "@SIZE@": str(size),
        "@RESULTS@": str(len(program.results)),
        "@POSES@": str(len(values)),
        "@SCALE@": number(_scale(values, each.least_scale)),
        "@PARAMETERS@": f"{function}_parameters" if len(each.parameters) else "0",
        "@SOUND@": f" || y[{size}] < 0.5" if len(program.results) > size else "",
    }
    test = _C_SELFTEST
    for token, value in filled.items():
        test = test.replace(token, value)
    return "\n".join([*lines, test])


def _scale(values: Array, least: float) -> float:
    """Return the size that differences are relative to."""
    finite = np.abs(values[np.isfinite(values)])
    return float(max(finite.max(initial=0.0), least)) or 1.0


def _referred(robot: Robot, name: str, each: Described, poses: Poses) -> tuple[list[int], Array]:
    """Return at which poses a quantity exists, for some may be singular for it, and its values there by Pinocchio."""
    rows, values = [], []
    for row in range(len(poses)):
        with suppress(SingularConfigurationError):
            values.append(each.reference(poses[[row]])[0])
            rows.append(row)
    if not rows or np.isnan(values).any():
        raise InvalidValueError(f"{name} of {robot.name}", "no number", "a quantity that exists at its poses")
    return rows, np.array(values)


def _module(controller: Controller, of: Sequence[str], described: Mapping[str, Described], to: Library) -> str:
    """Return the Python file."""
    robot = controller.robot
    numbers = controller.models["nominal"].numbers
    count = len(controller.parameters)
    programs = {
        "inverse_step": controller.inverse.step,
        "forward_step": controller.forward.step,
        **{part: controller.programs[part] for part in ("branch", "readings", "jacobian")},
    }
    parameters = list(zip(controller.parameters, numbers[:count].tolist(), strict=True))
    values = dict(parameters)
    for name, each in described.items():
        own = []
        for parameter, value in zip(each.program.parameters, each.parameters.tolist(), strict=True):
            # vibrations, for one, have masses at other joints
            own.append(parameter if values.get(parameter, value) == value else f"{name}/{parameter}")
            values[own[-1]] = value
        programs[name] = dataclasses.replace(each.program, parameters=tuple(own))
    parameters = list(values.items())
    names = tuple(values)
    poses = reachable_poses(robot, _POSES, np.random.default_rng(_SEED))
    ways = {
        "inverse": (controller.inverse, robot.coordinates, poses.coordinates),
        "forward": (controller.forward, robot.placing_commands, poses.commands[:, robot.placing_drives]),
    }
    found = {way: _legs(controller, walk, given, targets) for way, (walk, given, targets) in ways.items()}
    legs = {way: count for way, (count, _) in found.items()}
    reached = min(count for _, count in found.values())
    nq = controller.inverse.nq
    home = {
        way: controller.targets(given, _at_home(robot, given)[None])[0].tolist() for way, (_, given, _) in ways.items()
    }
    slices = controller.programs["readings"].slices
    settings = {
        "HOME": numbers[count : count + nq].tolist(),
        "MODES": dict(zip(ways, (int(mode) for mode in numbers[count + nq : count + nq + 2]), strict=True)),
        "BRANCH": float(numbers[-1]),
        "HOME_TARGETS": home,
        "LEGS": legs,
        "ORDER": {way: controller.order(given) for way, (_, given, _) in ways.items()},
        "OFFSETS": {way: [c.offset for c in given] for way, (_, given, _) in ways.items()},
        "SCALES": {way: [c.scale for c in given] for way, (_, given, _) in ways.items()},
        "PLACING": robot.placing_drives,
        "OTHERS": _others(robot),
        "READ": {group: (place.start, place.stop) for group, place in slices.items()},
    }
    shapes: dict[str, tuple[int, ...]] = {
        "commands": (len(robot.commands),),
        "coordinates": (len(robot.coordinates),),
        "transform": (4, 4),
        "jacobian": (len(robot.commands), len(robot.coordinates)),
        **{name: each.shape for name, each in described.items()},
    }
    golden = _golden(robot, of, described, poses)
    units = {
        "coordinates": ", ".join(f"{docstring(c.name)} [{c.unit}]" for c in robot.coordinates),
        "commands": ", ".join(f"{docstring(c.name)} [{c.unit}]" for c in robot.command_coordinates),
    }
    lines = [
        f'"""{docstring(robot.name)} for {to}, written by pm3dof export function: batched, differentiable.',
        "",
        f"coordinates: {units['coordinates']}",
        f"commands: {units['commands']}",
        "",
        "The last axis of arguments is that of the numbers. Poses that are out of reach or on another branch are NaN.",
        "Derivatives are right to second order. `parameters`, named by PARAMETER_NAMES, may be differentiated too.",
        *(_JIT if to == "jax" else ()),
        f"Loops are closed along a line from home in legs ({legs}), by which {reached} of {_POSES} random poses within",
        "limits were reached.",
        '"""',
        "",
        *([] if to in ("torch", "casadi") else ["import functools", ""]),
        IMPORTS[to],
        f"PARAMETER_NAMES = {names!r}",
        f"PARAMETERS = {[value for _, value in parameters]!r}",
        *(f"_{key} = {value!r}" for key, value in settings.items()),
        f"_SHAPES = {shapes!r}",
        f"_CLOSED = {_ACCEPTED!r}",
        f"_LONGEST_STEP = {WALK.jump!r}",
        f"_GOLDEN = {{{', '.join(golden)}}}",
        "",
        "",
        *("\n" + array_code(each.with_parameters(names), f"_{part}") for part, each in programs.items()),
        _CASADI if to == "casadi" else _BATCHED.replace("@PRELUDE@", _PRELUDES[to]),
        *(_definition(name, described.get(name), to) for name in of),
        _DIFFERENCE + (_SELFTEST_CASADI if to == "casadi" else _SELFTEST),
    ]
    return "\n".join(lines)


def _others(robot: Robot) -> list[tuple[int, float, float]]:
    """Return redundant drives: index, greatest difference of its command, period (a huge number for none)."""
    commands = robot.command_coordinates
    scales, turns = coordinate_scales(robot, commands), coordinate_periods(robot, commands)
    others = sorted(set(range(len(commands))) - set(robot.placing_drives))
    return [(k, float(AGREEING * scales[k]), min(float(turns[k]), 1e300)) for k in others]


def _at_home(robot: Robot, given: Sequence[Coordinate]) -> Vector:
    home = robot.at([robot.home.q])
    values = home.coordinates[0] if tuple(given) == robot.coordinates else home.commands[0, robot.placing_drives]
    return np.asarray(values)


def _legs(controller: Controller, walk: Walk, given: tuple[Coordinate, ...], values: Matrix) -> tuple[int, int]:
    """Return the number of legs by which the printed algorithm reaches the most poses, and how many these are."""
    model = controller.models["nominal"]
    count = len(controller.parameters)
    numbers, q = model.numbers[:count], model.numbers[count : count + walk.nq]
    targets = controller.targets(given, values)
    start = controller.targets(given, _at_home(controller.robot, given)[None])
    best, reached = 0, 0
    for legs in _LEGS:
        found, longest = np.tile(q, (len(targets), 1)), np.zeros(len(targets))
        shares = [min(k // _STEPS + 1, legs) / legs for k in range(_STEPS * legs + _LAST_STEPS)]
        for share in shares:
            outputs = _stepped(walk, found, start + share * (targets - start), numbers)
            found, longest = outputs[:, : walk.nq], np.maximum(longest, outputs[:, -2])
        closed = (_stepped(walk, found, targets, numbers)[:, -1] < _CLOSED) & (longest < WALK.jump)
        same = controller.programs["branch"].evaluate(found, numbers)[:, 0] == model.numbers[-1]
        if (n := int((closed & same).sum())) > reached:
            best, reached = legs, n
        if reached == len(targets) or legs >= 4 * best > 0:
            return best, reached
    raise ProgramError(f"{controller.robot.name}: straight lines from home reach none of its poses")


def _stepped(walk: Walk, q: Matrix, targets: Matrix, numbers: Vector) -> Array:
    return walk.step.evaluate(np.column_stack([q, np.tile([1.0, 0.0], (len(q), 1)), targets]), numbers)


def _golden(robot: Robot, of: Sequence[str], described: Mapping[str, Described], poses: Poses) -> list[str]:
    """Return arguments, values and their scale by quantity, as entries of a dictionary; computed by Pinocchio."""
    chosen = robot.solve(poses.coordinates[:_GOLDEN], guess=poses.q[:_GOLDEN], engine="pinocchio")
    golden = []
    for name in of:
        rows = list(range(len(chosen)))
        match name:
            case "commands":
                values = chosen.commands
            case "coordinates":
                values = chosen.coordinates
            case "transform":
                values = chosen.transforms
            case "jacobian":
                values = jacobian(robot, chosen, of="commands", by="coordinates", engine="pinocchio").values
            case _:
                rows, values = _referred(robot, name, described[name], chosen)
        arguments = (chosen.commands if name == "coordinates" else chosen.coordinates)[rows]
        scale = _scale(values, described[name].least_scale if name in described else 0.0)
        text = repr(values.tolist()).replace("inf", 'float("inf")')
        golden.append(f"{name!r}: ({arguments.tolist()!r}, {text}, {scale!r})")
    return golden


_JIT = ("Compile what calls them by `jit`, such as `jit(jax.jacfwd(commands))`: on a CPU, jax.jit takes far longer.",)
_PRELUDES: dict[Library, str] = {
    "numpy": """
def _stack(values, like, shape):
    like = np.asarray(like)
    flat = np.stack([np.broadcast_to(value, like.shape[:-1]) for value in values], axis=-1)
    return flat.reshape(like.shape[:-1] + shape)


def _array(values):
    return np.asarray(values, dtype=np.float64)


def _still(values):
    return values


def _repeat(count, body, q):
    for k in range(count):
        q = body(k, q)
    return q


def _twice(body, q):
    return body(body(q))


def _given(function):
    @functools.wraps(function)
    def quiet(values, parameters=None):
        with np.errstate(divide="ignore", invalid="ignore"):  # of branches that are not chosen
            return function(values, parameters)

    return quiet
""",
    "jax": """
def jit(function, **options):
    \"\"\"Compile as `jax.jit` does, on a CPU without a pass of XLA's that takes very long for such functions.\"\"\"
    without = {"xla_disable_hlo_passes": "fusion"} if jax.default_backend() == "cpu" else None
    return jax.jit(function, compiler_options=without, **options)


def _given(function):
    compiled = []

    @functools.wraps(function)
    def call(values, parameters=None):
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((values, parameters))):
            return function(values, parameters)
        if not compiled:
            compiled.append(jit(function))
        return compiled[0](_array(values), parameters)

    return call


def _stack(values, like, shape):
    flat = jnp.stack([jnp.broadcast_to(value, like.shape[:-1]) for value in values], axis=-1)
    return flat.reshape(like.shape[:-1] + shape)


def _array(values):
    return jnp.asarray(values, dtype=jnp.float64)


def _still(values):
    return [jax.lax.stop_gradient(value) for value in values]


def _repeat(count, body, q):
    return list(jax.lax.fori_loop(0, count, lambda k, q: tuple(body(k, q)), tuple(q)))


def _twice(body, q):
    shape = q[0].shape

    def step(q, _):
        return tuple(jnp.broadcast_to(jnp.asarray(value, jnp.float64), shape) for value in body(q)), None

    return list(jax.lax.scan(step, tuple(q), length=2)[0])
""",
    "torch": """
def _stack(values, like, shape):
    rows = [torch.as_tensor(value, dtype=torch.float64).to(like.device).expand(like.shape[:-1]) for value in values]
    return torch.stack(rows, dim=-1).reshape(like.shape[:-1] + shape)


def _array(values):
    return torch.as_tensor(values, dtype=torch.float64)


def _still(values):
    return [value.detach() if torch.is_tensor(value) else value for value in values]


def _repeat(count, body, q):
    with torch.no_grad():
        for k in range(count):
            q = body(k, q)
    return q


def _twice(body, q):
    return body(body(q))


def _given(function):
    return function
""",
}

_BATCHED = '''
@PRELUDE@

def _least(a, b):
    return where(a < b, a, b)


def configuration(values, parameters=None, way="inverse"):
    """Return q at coordinates (or, with way="forward", at commands), shape=(..., nq); NaN where there is none."""
    x = _array(values)
    p = PARAMETERS if parameters is None else parameters
    step = _inverse_step if way == "inverse" else _forward_step
    chosen = [x[..., k] for k in (_PLACING if way == "forward" else range(x.shape[-1]))]
    targets = [(chosen[k] - _OFFSETS[way][k]) / _SCALES[way][k] for k in _ORDER[way]]
    home, still, numbers, legs = _HOME_TARGETS[way], _still(targets), _still(p), _LEGS[way]

    def body(k, state):
        share = _least((k // STEPS + 1) / legs, 1.0)
        there = [h + share * (t - h) for h, t in zip(home, still)]
        *q, _, jump, _ = step([*state[:-1], 1.0, 0.0, *there], numbers)
        return [*q, where(jump < state[-1], state[-1], jump)]

    def end(state):
        *q, margin, _, residual = step([*state[:-2], 1.0, 0.0, *targets], p)
        return [*q, margin, residual]

    zero = 0.0 * still[0]
    *q, jump = _still(_repeat(STEPS * legs + LAST, body, [h + zero for h in [*_HOME, 0.0]]))
    *q, margin, residual = _twice(end, [*q, zero, zero])
    found = _and(residual < _CLOSED, _branch(_still(q), numbers)[0] == _BRANCH)
    found = _and(found, jump < _LONGEST_STEP)
    found = _and(found, -floor(0.5 * _still([margin])[0]) == _MODES[way])
    for k, most, turn in _OTHERS if way == "forward" else ():  # redundant drives must agree
        off = _readings(_still(q), numbers)[k] - _still([x[..., k]])[0]
        found = _and(found, fabs(off - turn * floor(off / turn + 0.5)) <= most)
    return _stack([where(found, value, float("nan")) for value in q], x, (len(_HOME),))


def _at(values, p, way="inverse"):
    q = configuration(values, p, way)
    return [q[..., k] for k in range(len(_HOME))], PARAMETERS if p is None else p
'''.replace("STEPS", str(_STEPS)).replace("LAST", str(_LAST_STEPS))

_CASADI = '''
def _closed(way):
    """Return a function of coordinates (or, with way "forward", of commands): q, NaN where there is none."""
    nq, m = len(_HOME), len(_ORDER[way])
    step = _inverse_step if way == "inverse" else _forward_step
    q, t = casadi.SX.sym("q", nq), casadi.SX.sym("t", m)
    out = step([*casadi.vertsplit(q), 1.0, 0.0, *casadi.vertsplit(t)], PARAMETERS)
    newton = casadi.Function("newton", [q, t], [casadi.vertcat(*out[:nq]), out[nq], out[nq + 2], out[nq + 1]])
    branch = casadi.Function("branch", [q], [casadi.SX(_branch(casadi.vertsplit(q), PARAMETERS)[0])])
    targets, home = casadi.MX.sym("targets", m), casadi.DM(_HOME_TARGETS[way])
    here = casadi.MX(casadi.DM(_HOME))
    longest = casadi.MX(0.0)
    for k in range(STEPS * _LEGS[way] + LAST):
        share = min((k // STEPS + 1) / _LEGS[way], 1.0)
        here, _, _, jump = newton(here, home + share * (targets - home))
        longest = casadi.fmax(longest, jump)
    settings = {"is_diff_in": [False], "is_diff_out": [False, False]}
    walk = casadi.Function("walk", [targets], [here, longest], settings)
    values = casadi.MX.sym("values", _SHAPES["coordinates" if way == "inverse" else "commands"][0])
    chosen = casadi.vertcat(*(values[k] for k in (_PLACING if way == "forward" else range(m))))
    scaled = (chosen - casadi.DM(_OFFSETS[way])) / casadi.DM(_SCALES[way])
    targets = casadi.vertcat(*(scaled[k] for k in _ORDER[way]))
    here, longest = walk(targets)
    for _ in range(2):
        here, margin, residual, _ = newton(here, targets)
    found = _and(_and(residual < _CLOSED, branch(here) == _BRANCH), -floor(0.5 * margin) == _MODES[way])
    found = _and(found, longest < _LONGEST_STEP)
    if _OTHERS and way == "forward":  # redundant drives must agree
        commands = _readings(casadi.vertsplit(q), PARAMETERS)[slice(*_READ["commands"])]
        read = casadi.Function("read", [q], [casadi.vertcat(*commands)])
        for k, most, turn in _OTHERS:
            off = read(here)[k] - values[k]
            found = _and(found, fabs(off - turn * floor(off / turn + 0.5)) <= most)
    return casadi.Function("configuration", [values], [where(found, here, casadi.DM.nan(nq))])


def _function(name, program, way="inverse"):
    """Return a casadi.Function of coordinates (or, with way "forward", of commands)."""
    shape, closed = _SHAPES[name], _closed(way)
    q = casadi.SX.sym("q", len(_HOME))
    flat = casadi.vertcat(*map(casadi.SX, program(casadi.vertsplit(q))))
    if len(shape) > 1:  # CasADi has matrices only: all axes but the last are its rows
        flat = casadi.reshape(flat, shape[-1], flat.numel() // shape[-1]).T
    values = casadi.MX.sym("values", closed.size1_in(0))
    return casadi.Function(name, [values], [casadi.Function("at_q", [q], [flat])(closed(values))])
'''.replace("STEPS", str(_STEPS)).replace("LAST", str(_LAST_STEPS))

_IF_SOUND = "[where(found[-1] > 0.5, value, float('nan')) for value in found[:-1]]"
_SOURCES = {
    "commands": "_readings(q, p)[slice(*_READ['commands'])]",
    "coordinates": "_readings(q, p)[slice(*_READ['coordinates'])]",
    "transform": "_readings(q, p)[slice(*_READ['transform'])]",
    "jacobian": _IF_SOUND,
}
_TEXTS = {
    "commands": "Return the commands at coordinates, shape=(..., commands) [m, rad].",
    "coordinates": "Return the coordinates at commands, shape=(..., coordinates) [m, rad].",
    "transform": "Return the placement of the tool at coordinates, shape=(..., 4, 4) [m].",
    "jacobian": "Return the rates of the commands by those of the coordinates, at coordinates, "
    "shape=(..., commands, coordinates).",
}


def _definition(name: str, described: Described | None, to: Library) -> str:
    way = "forward" if name == "coordinates" else "inverse"
    source = _SOURCES.get(name, _IF_SOUND)
    if described is None:
        text = _TEXTS[name]
    else:
        shape = f"..., {described.axes}" if described.axes else "..."
        text = docstring(f"Return {described.text}, at coordinates, shape=({shape}).")
        if len(described.program.results) == np.prod(described.shape):
            source = "found"
    first = f"    found = _{name}(q, p)\n" if "found" in source else ""
    if to == "casadi":
        return (
            f"\n\ndef _{name}_at(q, p=PARAMETERS):\n{first}    return {source}\n\n\n"
            f'{name} = _function("{name}", _{name}_at, "{way}")  # {text}\n'
        )
    return (
        f'\n\n@_given\ndef {name}(values, parameters=None):\n    """{text}"""\n'
        f'    q, p = _at(values, parameters, "{way}")\n{first}'
        f'    return _stack({source}, _array(values), _SHAPES["{name}"])\n'
    )


_DIFFERENCE = """

def _difference(found, wanted):
    with np.errstate(invalid="ignore"):
        return float(np.where(found == wanted, 0.0, np.abs(found - wanted)).max())
"""

_SELFTEST = '''

def _selftest():
    """Return the greatest relative differences from values computed by Pinocchio, by function."""
    worst = {}
    for name, (arguments, values, scale) in _GOLDEN.items():
        found, wanted = np.asarray(globals()[name](_array(arguments))), np.array(values)
        worst[name] = _difference(found, wanted) / scale
        if not worst[name] < 1e-9:
            raise ValueError(f"{name} is off by {worst[name]:.3g} of its size")
    return worst


if __name__ == "__main__":
    print(_selftest())
'''

_SELFTEST_CASADI = '''

def _selftest():
    """Return the greatest relative differences from values computed by Pinocchio, by function."""
    worst = {}
    for name, (arguments, values, scale) in _GOLDEN.items():
        found = np.array([np.array(globals()[name](row)).ravel() for row in arguments])
        worst[name] = _difference(found, np.array(values).reshape(found.shape)) / scale
        if not worst[name] < 1e-9:
            raise ValueError(f"{name} is off by {worst[name]:.3g} of its size")
    return worst


if __name__ == "__main__":
    print(_selftest())
'''

_C_SELFTEST = """#ifndef INFINITY
#define INFINITY HUGE_VAL
#endif

/* Compare with values computed by Pinocchio; returns at how many poses one is wrong by more than rounding, and the
   worst difference, relative to the greatest value. */
int @NAME@_selftest(double *worst)
{
  double y[@RESULTS@], error;
  int n, k, wrong = 0, differs;
  *worst = 0.0;
  for (n = 0; n < @POSES@; n++) {
    @NAME@(@NAME@_golden_q + @NQ@ * n, @PARAMETERS@, y);
    differs = 0@SOUND@;
    for (k = 0; k < @SIZE@; k++) {
      const double wanted = @NAME@_golden[@SIZE@ * n + k];
      error = y[k] == wanted ? 0.0 : fabs(y[k] - wanted) / @SCALE@;
      if (!(error < 1e-9))
        differs = 1;
      if (!(error <= *worst))
        *worst = error;
    }
    wrong += differs;
  }
  return wrong;
}
"""
