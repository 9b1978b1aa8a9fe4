"""The package's errors: one base class, one class per cause.

Every message names what is wrong, where it is and what was expected. The exception carries the same data as
attributes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

_MAX_LENGTH = 2000
_MAX_LINES = 10


def _nearest(name: str, known: Sequence[str], most: int = 8) -> str:
    """List the known names, or the closest matches if there are many."""
    if len(known) <= most:
        return ", ".join(known)
    import difflib  # rarely needed, and slow to import

    alike = difflib.get_close_matches(name, known, n=most, cutoff=0.0)
    return f"{', '.join(alike)} and {len(known) - len(alike)} more"


_MOST_WORDS = 8  # values in a list, as of the drives of most robots: about a line


class PM3DofError(Exception):
    """Base class of all errors this package raises deliberately. Messages are one line of moderate length."""

    def __str__(self) -> str:
        """Return the message with unprintable characters escaped: names from files may contain anything."""
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in super().__str__())
        return text if len(text) <= _MAX_LENGTH else f"{text[: _MAX_LENGTH // 2]} ... {text[-_MAX_LENGTH // 2 :]}"

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without calling the constructor, which takes other arguments than the message."""
        return _remade, (type(self), self.args, self.__dict__)


def _remade(kind: type[PM3DofError], arguments: tuple[object, ...], data: dict[str, object]) -> PM3DofError:
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(data)
    return error


class UnknownRobotError(PM3DofError):
    """The requested robot name or path does not exist."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        self.name = name
        self.known = tuple(known)
        super().__init__(
            f"no robot '{name}': expected one of {', '.join(self.known)}, a robot of example-robot-data if that is "
            "installed, or the path of a URDF, xacro, MJCF or closures file, or of a folder containing one"
        )


class DescriptionError(PM3DofError):
    """A description file is missing, unreadable or invalid.

    Attributes:
        path: the file.
        element: the key, tag or line in the file.
        expected: what was expected there.
        line: the line, from 1, if known.
    """

    def __init__(self, path: Path | str, element: str, expected: str, line: int | None = None) -> None:
        self.path = Path(path)
        self.line = line
        self.element = " ".join(element.split())
        self.expected = " ".join(expected.split())
        place = self.path if line is None else f"{self.path}, line {line}"
        super().__init__(f"{place}: {self.element}: {self.expected}")


class _NotFoundError(PM3DofError):
    """The model has nothing of this name."""

    kind = ""

    def __init__(self, name: str, source: str, known: Sequence[str]) -> None:
        self.name = name
        self.source = source
        self.known = tuple(known)
        super().__init__(f"{source}: no {self.kind} '{name}' in the model; it has {_nearest(name, self.known)}")


class FrameNotFoundError(_NotFoundError):
    """The model has no frame of this name."""

    kind = "frame"


class JointNotFoundError(_NotFoundError):
    """The model has no joint of this name."""

    kind = "joint"


class InvalidValueError(PM3DofError, ValueError):
    """An argument has an invalid value (NaN, infinite, wrong sign, wrong kind).

    Attributes:
        name: the argument.
        value: its value, or None if the message says in words what is wrong with it.
        expected: what was expected.
    """

    def __init__(self, name: str, value: object = None, expected: str = "", *, problem: str = "") -> None:
        self.name = name
        self.value = value
        self.expected = expected
        subject = f"{name} {problem}" if problem else f"{name} = {value}"
        super().__init__(subject + (f": expected {expected}" if expected else ""))


class ShapeError(InvalidValueError):
    """An array has the wrong shape.

    Attributes:
        shape: its shape.
    """

    def __init__(self, name: str, shape: tuple[int, ...], expected: object) -> None:
        self.shape = shape
        super().__init__(name, expected=str(expected), problem=f"of shape {shape}")


class UnreachablePoseError(PM3DofError):
    """No joint positions were found that bring the tool to this pose.

    Attributes:
        residual: the remaining closure error [m, rad], or None if no solver ran.
        reason: the cause, or "" if unknown.
    """

    def __init__(self, message: str, residual: float | None = None, reason: str = "") -> None:
        self.residual = residual
        self.reason = reason
        super().__init__(message)


class ConvergenceError(PM3DofError):
    """An iterative solver did not reach its tolerance.

    Attributes:
        residual: the remaining residual, in the unit given in the message.
        steps: iterations done.
    """

    def __init__(self, task: str, residual: float, unit: str, steps: int, advice: str = "") -> None:
        self.residual = residual
        self.steps = steps
        super().__init__(
            f"{task} did not converge: residual {residual:.3e} {unit} after {steps} steps"
            + (f"; {advice}" if advice else "")
        )


class AmbiguousHomeError(ConvergenceError):
    """The loops are open at home and close in several ways near it, so that nothing says which one is meant.

    Attributes:
        residual: closure error of the described home [m, rad].
        steps: iterations done for one of the ways.
    """

    def __init__(self, robot: str, residual: float, steps: int, advice: str) -> None:
        self.residual = residual
        self.steps = steps
        PM3DofError.__init__(
            self, f"{robot}: at home the loops are open by {residual:.3g} m or rad and close in several ways: {advice}"
        )


class DeflectionRangeError(PM3DofError):
    """Loads deflect a spring further than a body of its size can deflect.

    Attributes:
        factor: the load factor of the last valid step.
    """

    def __init__(self, deflection: str, factor: float) -> None:
        self.factor = factor
        super().__init__(
            f"beyond a factor of {factor:.6g}, {deflection}: expected smaller loads, or a body divided into more "
            "springs"
        )


class SingularConfigurationError(PM3DofError):
    """A quantity is undefined because the mechanism is in a singular configuration, named in the message."""


class FreeDirectionError(SingularConfigurationError):
    """A compliance is undefined: the frame can move without deflecting a spring. The message names the directions."""


class RigidDirectionError(SingularConfigurationError):
    """A stiffness is undefined: no spring deflects in some direction. The message names the directions."""


class ProgramError(PM3DofError):
    """A mechanism has no program, or its program disagrees with Pinocchio or cannot be compiled on this machine.

    The message says why.
    """


class OutputError(PM3DofError):
    """A file or folder cannot be written. No partial output is left behind."""

    def __init__(self, path: Path | str, reason: str) -> None:
        self.path = Path(path)
        self.reason = reason
        super().__init__(f"cannot write {self.path}: {reason}")


class ServerError(PM3DofError):
    """The viewer cannot listen at the given address."""


class BrowserError(PM3DofError):
    """No browser was found, or it failed."""


class MeasurementError(PM3DofError):
    """A table of measurements or poses cannot be used as it is.

    Attributes:
        path: the file.
        problem: what is wrong with it.
        rows: the affected lines of the file, the header being line 1; empty if all are.
    """

    def __init__(self, path: Path | str, problem: str, rows: Sequence[int] = ()) -> None:
        self.path, self.problem = Path(path), problem
        self.rows = tuple(rows)
        super().__init__(f"{self.path}: {lines_in_words(self.rows)}{problem}")


def first_words(words: Sequence[str]) -> str:
    """Join words for a message; of many the first, and how many more there are, lest they hide the rest of it."""
    more = len(words) - _MOST_WORDS
    return ", ".join(words[:_MOST_WORDS]) + (f", ... ({more} more)" if more > 0 else "")


def lines_in_words(rows: Sequence[int]) -> str:
    """Return "line 3: ", "lines 3, 5, 9: " or "", with long lists shortened."""
    if not rows:
        return ""
    listed = ", ".join(str(row) for row in rows[:_MAX_LINES])
    more = f" and {len(rows) - _MAX_LINES} more" if len(rows) > _MAX_LINES else ""
    return f"line{'s' if len(rows) > 1 else ''} {listed}{more}: "


class GCodeError(PM3DofError):
    """A line of a program in G-code is not understood.

    Attributes:
        path: the file.
        line: the line.
    """

    def __init__(self, path: Path | str, line: int, problem: str) -> None:
        self.path, self.line = Path(path), line
        super().__init__(f"{self.path}: line {line}: {problem}")


class CalibrationRefusedError(PM3DofError):
    """A calibration was refused: its result would be wrong for the machine, or make it worse.

    Attributes:
        reasons: one sentence each, the likeliest cause last.
    """

    def __init__(self, reasons: Sequence[str]) -> None:
        super().__init__(f"no calibration: {'; '.join(reasons)}")
        self.reasons = tuple(reasons)
