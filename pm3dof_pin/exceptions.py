"""All errors of the package: one base class, one class per cause.

Every message names the thing that is wrong, where it stands and what was expected; the same data is kept on the
exception for programs that catch it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

_LONGEST = 2000
_MOST_LINES = 10


def _nearest(name: str, known: Sequence[str], most: int = 8) -> str:
    """List the known names; of many, those that are most like the name."""
    if len(known) <= most:
        return ", ".join(known)
    import difflib  # rarely needed, and slow to import

    alike = difflib.get_close_matches(name, known, n=most, cutoff=0.0)
    return f"{', '.join(alike)} and {len(known) - len(alike)} more"


class PM3DofError(Exception):
    """Base class of every error this package raises on purpose. Its message is one line of moderate length."""

    def __str__(self) -> str:
        """Return the message: names from files may hold anything, so what does not print is escaped."""
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in super().__str__())
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 2 :]}"

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without calling the constructor again, whose arguments are not those of the message."""
        return _remade, (type(self), self.args, self.__dict__)


def _remade(kind: type[PM3DofError], arguments: tuple[object, ...], data: dict[str, object]) -> PM3DofError:
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(data)
    return error


class UnknownRobotError(PM3DofError):
    """A robot was asked for by a name or path that does not exist."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        self.name = name
        self.known = tuple(known)
        super().__init__(
            f"no robot '{name}': expected one of {', '.join(self.known)}, one of example-robot-data if that is "
            "installed, or the path of a URDF, a xacro, an MJCF or a closures file, or of the folder of one"
        )


class DescriptionError(PM3DofError):
    """A description file is missing, cannot be read, or says something it must not say.

    Attributes:
        path: the file.
        element: the key, tag or line inside the file.
        expected: what should stand there.
    """

    def __init__(self, path: Path | str, element: str, expected: str) -> None:
        self.path = Path(path)
        self.element = " ".join(element.split())
        self.expected = " ".join(expected.split())
        super().__init__(f"{self.path}: {self.element}: {self.expected}")


class _NotFoundError(PM3DofError):
    """Something is named that the model does not have."""

    kind = ""

    def __init__(self, name: str, source: str, known: Sequence[str]) -> None:
        self.name = name
        self.source = source
        self.known = tuple(known)
        super().__init__(f"{source}: no {self.kind} '{name}' in the model; it has {_nearest(name, self.known)}")


class FrameNotFoundError(_NotFoundError):
    """A frame is named that the model does not have."""

    kind = "frame"


class JointNotFoundError(_NotFoundError):
    """A joint is named that the model does not have."""

    kind = "joint"


class InvalidValueError(PM3DofError, ValueError):
    """An argument is not a number that can be worked with (NaN, infinite, of the wrong shape or sign)."""

    def __init__(self, name: str, value: object, expected: str) -> None:
        self.name = name
        self.value = value
        self.expected = expected
        super().__init__(f"{name} = {value}: expected {expected}")


class UnreachablePoseError(PM3DofError):
    """No joint variables were found that bring the tool to this pose.

    Attributes:
        residual: what was left of the closure error [m, rad], or None if it was not solved for.
        reason: what is in the way, "" if it is not known.
    """

    def __init__(self, message: str, residual: float | None = None, reason: str = "") -> None:
        self.residual = residual
        self.reason = reason
        super().__init__(message)


class ConvergenceError(PM3DofError):
    """An iterative solver stopped short of its tolerance.

    Attributes:
        residual: what was left, in the unit the message says.
        steps: iterations done.
    """

    def __init__(self, task: str, residual: float, unit: str, steps: int, advice: str = "") -> None:
        self.residual = residual
        self.steps = steps
        super().__init__(
            f"{task} did not converge: residual {residual:.3e} {unit} after {steps} steps"
            + (f"; {advice}" if advice else "")
        )


class DeflectionRangeError(PM3DofError):
    """Loads deflect a spring further than a body of its size can be.

    Attributes:
        factor: what the loads were multiplied by before.
    """

    def __init__(self, deflection: str, factor: float) -> None:
        self.factor = factor
        super().__init__(
            f"beyond a factor of {factor:.6g} {deflection}: expected smaller loads, or a body cut into more springs"
        )


class SingularConfigurationError(PM3DofError):
    """A quantity does not exist because the mechanism is in a singular configuration, which the message names."""


class FreeDirectionError(SingularConfigurationError):
    """A compliance does not exist: the frame can move with all springs at rest. The message names the directions."""


class RigidDirectionError(SingularConfigurationError):
    """A stiffness does not exist: no spring gives in some direction. The message names the directions."""


class ProgramError(PM3DofError):
    """A mechanism has no program, or its program does not agree with Pinocchio, or cannot be compiled on this machine.

    The message says why.
    """


class OutputError(PM3DofError):
    """A file or folder cannot be written. Nothing was left half-written."""

    def __init__(self, path: Path | str, reason: str) -> None:
        self.path = Path(path)
        self.reason = reason
        super().__init__(f"cannot write {self.path}: {reason}")


class ServerError(PM3DofError):
    """The viewer cannot listen at the given address."""


class BrowserError(PM3DofError):
    """No browser was found, or it did not do what was asked of it."""


class MeasurementError(PM3DofError):
    """A file of measurements cannot be used as it is.

    Attributes:
        path: the file.
        rows: lines of the file that are meant, the header being line 1; empty where all of them are.
    """

    def __init__(self, path: Path | str, problem: str, rows: Sequence[int] = ()) -> None:
        self.path = Path(path)
        self.rows = tuple(rows)
        super().__init__(f"{self.path}: {lines_in_words(self.rows)}{problem}")


def lines_in_words(rows: Sequence[int]) -> str:
    """Return "line 3: ", "lines 3, 5, 9: " or nothing, long lists cut short."""
    if not rows:
        return ""
    listed = ", ".join(str(row) for row in rows[:_MOST_LINES])
    more = f" and {len(rows) - _MOST_LINES} more" if len(rows) > _MOST_LINES else ""
    return f"line{'s' if len(rows) > 1 else ''} {listed}{more}: "


class CalibrationRefusedError(PM3DofError):
    """A calibration whose result would not be true of the machine, or would make it worse.

    Attributes:
        reasons: why, a sentence each, the likeliest cause last.
    """

    def __init__(self, reasons: Sequence[str]) -> None:
        super().__init__(f"no calibration: {'; '.join(reasons)}")
        self.reasons = tuple(reasons)
