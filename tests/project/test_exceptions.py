"""The package's errors pass between processes with their text and data."""

from __future__ import annotations

import inspect
import pickle
from pathlib import Path

import pytest

from pm3dof_pin import exceptions
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError

KINDS = [kind for _, kind in inspect.getmembers(exceptions, inspect.isclass) if issubclass(kind, PM3DofError)]
EXAMPLES = {"path": Path("a.yaml"), "known": ("b", "c"), "residual": 1.0, "steps": 3, "names": ["d"]}


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_is_the_same_after_a_pickle(kind: type[PM3DofError]) -> None:
    names = [name for name in inspect.signature(kind.__init__).parameters if name not in ("self", "args", "kwargs")]
    values = [EXAMPLES.get(name, f"some {name}") for name in names]
    try:
        error = kind(*values)
    except (TypeError, ValueError):
        pytest.skip("made of other things")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def test_a_message_is_one_line_whatever_a_name_holds() -> None:
    message = str(InvalidValueError("joint", "a\nb\x1b[31m\u2028\u202e" + "x" * 100_000, "a name"))
    assert message.isprintable()
    assert message.startswith("joint = a\\nb\\x1b[31m\\u2028\\u202exxx")
    assert message.endswith("xxx: expected a name")
    assert len(message) < 3000
