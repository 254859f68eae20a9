"""Trials as files of others state them: who tried which task, and whether it was a success. All values are checked."""

from __future__ import annotations

import re
import reprlib
from dataclasses import dataclass
from typing import Any

from robogauntlet.support.text import visible

LARGEST_FILE = 64 * 2**20
"""Largest size of a file of results (bytes)."""
MOST_TRIALS = 1_000_000
"""Trials of an import."""
LONGEST_LABEL = 300
"""Largest length of the name of a task, a policy or a trial (characters)."""
LONGEST_ERROR = 4_000
"""Largest length of an error (characters); longer ones are cut."""
SUCCESS = dict.fromkeys(("true", "yes", "1", "1.0", "success"), True) | dict.fromkeys(
    ("false", "no", "0", "0.0", "failure"), False
)
"""How a success, or a failure, is written."""
NO_LABELS = ("nan", "inf", "-inf", "none", "null")
"""What programs write where there is no name or number."""
_WHOLE = re.compile(r"([0-9]{1,9})(\.0+)?")


class BadResults(ValueError):
    """Results that cannot be read; the message says what was expected and does not name the file."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial of a policy at a task."""

    policy: str
    task: str
    """`simulator/task`."""
    label: str
    """What tells it from the other trials of the policy at the task."""
    success: bool | None
    """None for one that ended in an error."""
    error: str | None = None


@dataclass(frozen=True, slots=True)
class Results:
    """What a file holds."""

    source: str
    """The format in words, such as `a table of trials`."""
    trials: tuple[Trial, ...]
    paired: bool
    """Whether trials of two policies with one task and label are said to start from the same state."""
    notes: tuple[str, ...] = ()
    """What the user is told of the file, a sentence each."""


def read_success(value: Any, where: str) -> bool:
    """Return whether a value says success. Raises BadResults for one that says neither success nor failure."""
    found = SUCCESS.get(str(value).strip().lower()) if isinstance(value, bool | int | float | str) else None
    if found is None:
        words = "true or false (1, 0, yes, no, success, failure)"
        raise BadResults(f"{where}: expected success as {words}, got {_shown(value)}")
    return found


def read_label(value: Any, what: str, where: str) -> str:
    """Return a name or number as a text; 7, "7" and 7.0 are one. Raises BadResults."""
    is_text = isinstance(value, int | float | str) and not isinstance(value, bool)
    text = str(value).strip() if is_text else ""
    if not text or text.lower() in NO_LABELS or not text.isprintable() or len(text) > LONGEST_LABEL:
        limit = f"of at most {LONGEST_LABEL} printable characters"
        raise BadResults(f"{where}: expected a {what} {limit}, got {_shown(value)}")
    whole = _WHOLE.fullmatch(text)
    return str(int(whole[1])) if whole and what != "task" else text


def read_list(value: Any, where: str) -> list[Any]:
    """Return a list of at most `MOST_TRIALS` values. Raises BadResults."""
    if not isinstance(value, list):
        raise BadResults(f"{where}: expected a list, got {_shown(value)}")
    return check_number(value)


def check_number(trials: list[Any]) -> list[Any]:
    """Return a list that is not too long. Raises BadResults."""
    if len(trials) > MOST_TRIALS:
        raise BadResults(f"expected at most {MOST_TRIALS:,} trials, got more")
    return trials


def read_mapping(value: Any, where: str) -> dict[str, Any]:
    """Return a JSON object. Raises BadResults."""
    if not isinstance(value, dict):
        raise BadResults(f"{where}: expected an object, got {_shown(value)}")
    return value


def refuse_task(task: str | None) -> None:
    """Refuse a task that the user states for a file that names its tasks. Raises BadResults."""
    if task is not None:
        raise BadResults("expected no --task, the file names its tasks")


def task_name(task: str) -> str:
    """Return `simulator/task`: a task without a simulator is one of `trials`."""
    simulator, slash, rest = task.partition("/")
    return task if slash and simulator and rest else f"trials/{task.strip('/') or '-'}"


def _shown(value: Any) -> str:
    return "nothing" if value in ("", None) else visible(reprlib.repr(value))
