"""Reads suite and configuration files. Reports mistakes with file, line and the nearest valid name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from robogauntlet.suites.checks import MOST_MISTAKES, check_names
from robogauntlet.suites.designs import DesignEntry
from robogauntlet.suites.environments import Config, EnvironmentEntry
from robogauntlet.suites.plugins import did_you_mean, few_hints
from robogauntlet.suites.registry import Registry
from robogauntlet.suites.resources import Inference, Resources
from robogauntlet.suites.schema import (
    AdaptiveEntry,
    CompareEntry,
    ConditionEntry,
    MergingEntry,
    Mistake,
    PolicyEntry,
    Seeds,
    Suite,
    policy_entry,
)
from robogauntlet.suites.yaml_file import Place, YamlError, parse_yaml, read_yaml
from robogauntlet.support.errors import UserError, plain_words
from robogauntlet.support.text import shortened, visible

LONGEST_MESSAGE, LONGEST_VALUE = 400, 60
"""Characters of a message, and of a wrong value in it."""
Model = TypeVar("Model", Suite, Config)


@dataclass(frozen=True)
class Problem:
    """One mistake in a suite file."""

    path: str
    line: int | None
    message: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.message}" if self.line else f"{self.path}: {self.message}"


class SuiteError(UserError):
    """A suite file with mistakes. The message has one line per problem, up to `MOST_MISTAKES`."""

    def __init__(self, problems: list[Problem]) -> None:
        self.problems = sorted(problems, key=lambda p: p.line or 0)
        if len(problems) > MOST_MISTAKES:
            more = Problem(problems[0].path, None, f"more than {MOST_MISTAKES} mistakes, of which these are shown:")
            self.problems = [*dict.fromkeys([more, *self.problems[:MOST_MISTAKES]])]
        super().__init__("\n".join(map(str, self.problems)))


def load_suite(path: Path, names: Registry, text: str | None = None) -> Suite:
    """Read and validate a suite file, with names of the registry only, and expand its task patterns.

    Args:
        path: The file.
        names: The names that exist.
        text: Its text, if it is not written yet.

    Raises:
        SuiteError: Holds every mistake of form, or if there is none every unknown name.
    """
    text = _read(path, "a suite file") if text is None else text
    suite = _load(path, text, Suite, partial(check_names, names=names), "name, policies, tasks and seeds")
    return suite.with_names(names)


def load_config(path: Path, names: Sequence[str], with_assets: Sequence[str] = ()) -> Config:
    """Read and validate a configuration file, which may be empty.

    Args:
        path: The file.
        names: Those that can have an environment.
        with_assets: Simulators that can have a folder of assets.

    Raises:
        SuiteError: Holds every problem found.
    """

    def unknown(config: Config) -> list[Mistake]:
        known = {"environments": names, "assets": with_assets}
        named = ((key, name) for key in known for name in getattr(config, key) if name not in known[key])
        wrong = {"environments": "unknown simulator", "assets": "no simulator that finds assets of yours:"}
        return [((key, name), f"{wrong[key]} '{name}'{did_you_mean(name, known[key])}") for key, name in named]

    return _load(path, _read(path, "a configuration file"), Config, unknown, ", ".join(Config.model_fields))


def _load(path: Path, text: str, model: type[Model], check: Callable[[Model], Sequence[Mistake]], keys: str) -> Model:
    is_empty = all(not line.strip() or line.lstrip().startswith("#") for line in text.splitlines())
    data, lines = _parse(path, "{}" if is_empty and model is Config else text, keys)
    with few_hints():
        try:
            loaded = model.model_validate(data)
        except ValidationError as error:
            # A list with wrong entries is also called too short.
            wrong = [e for e in error.errors() if e["type"] != "too_short" or not e["input"]]
            places = ((_place(e["loc"]), _message(e, model)) for e in wrong[: MOST_MISTAKES + 1])
            raise _refusal(path, lines, places) from None
        if mistakes := check(loaded):
            raise _refusal(path, lines, mistakes)
        return loaded


def problem_at(path: Path, line: int | None, message: str) -> Problem:
    """Return a problem whose message is one line of moderate length, whatever names the file has."""
    return Problem(str(path), line, shortened(visible(message), LONGEST_MESSAGE))


def _refusal(path: Path, lines: dict[Place, int], mistakes: Iterable[Mistake]) -> SuiteError:
    # Each problem once: a value that fits neither side of a union is reported by both.
    problems = (problem_at(path, _line(lines, place), message) for place, message in mistakes)
    return SuiteError([*dict.fromkeys(problems)])


def policy_lines(text: str) -> dict[str, int]:
    """Return the line of each policy that can be read in the text of a suite, by name."""
    document = parse_yaml(text)
    entries = document.data.get("policies")
    lines = {}
    for i, entry in enumerate(entries if isinstance(entries, list) else ()):
        named = policy_entry(entry) if isinstance(entry, str) else entry
        if isinstance(named, dict) and (line := document.lines.get(("policies", i))):
            lines[str(named.get("name", named.get("kind")))] = line
    return lines


def _read(path: Path, what: str) -> str:
    try:
        return read_yaml(path, what)
    except YamlError as error:
        raise SuiteError([Problem(str(path), None, str(error))]) from None


def _parse(path: Path, text: str, keys: str) -> tuple[dict[str, Any], dict[Place, int]]:
    """Return the file's data, and the line number of each place in it."""
    try:
        document = parse_yaml(text)
    except YamlError as error:
        raise SuiteError([problem_at(path, error.line, str(error))]) from None
    if document.duplicates:
        twice = document.duplicates[: MOST_MISTAKES + 1]
        raise SuiteError([problem_at(path, line, f"duplicate key '{name}'") for line, name in twice])
    if not isinstance(document.data, dict):
        raise SuiteError([Problem(str(path), None, f"expected a mapping with {keys}; found {_kind(document.data)}")])
    return document.data, document.lines


def _line(lines: dict[Place, int], place: Place) -> int | None:
    """Return the line of the longest prefix of `place` that is in the file."""
    prefixes = (place[:length] for length in range(len(place), -1, -1))
    return next((lines[prefix] for prefix in prefixes if prefix in lines), None)


def _place(loc: Place) -> Place:
    """Return a location of pydantic without the names of union branches, which `workers` has."""
    branches = ("int", "dict", "auto") if loc[:1] == ("workers",) else ()
    return tuple(part for part in loc if part not in branches)


def _message(error: Any, model: type[BaseModel]) -> str:
    place = _place(error["loc"])
    where = ".".join(str(part + 1) if isinstance(part, int) else part for part in place)
    value = error.get("input")
    shown = _shown(value)
    match error["type"]:
        case "missing":
            return f"missing key '{place[-1]}'"
        case "extra_forbidden":
            return f"unknown key '{place[-1]}'{did_you_mean(str(place[-1]), _fields(place, model))}"
        case "too_short":
            return f"{where}: expected at least one entry, found an empty list"
        case "greater_than_equal" | "greater_than" | "less_than_equal" | "less_than":
            return f"{where}: {error['msg'].replace('Input should be', 'expected a value')}, found {shown}"
        case "enum" | "literal_error":
            return f"{where}: expected {error['ctx']['expected']}, found {shown}"
        case "string_pattern_mismatch":
            rule = "letters, digits, '.', '_' or '-', starting with a letter or digit"
            return f"{where}: expected {rule}; found {shown}"
        case "string_too_long":
            return f"{where}: expected at most {error['ctx']['max_length']} characters, found {_kind(value)}"
        case "dict_type":
            return f"{where}: expected a mapping, found {_kind(value)}"
        case "tuple_type" | "list_type":
            return f"{where}: expected a list, found {_kind(value)}"
        case "value_error" if ", got " in error["msg"]:
            return f"{where}: {plain_words(error['msg'])}"
        case _:
            expected = plain_words(error["msg"]).replace("Input should be", "expected")
            return f"{where}: {expected}, found {_kind(value)}"


def _fields(place: Place, root: type[BaseModel]) -> list[str]:
    models: dict[str, type[BaseModel]] = {
        "policies": PolicyEntry,
        "conditions": ConditionEntry,
        "design": DesignEntry,
        "seeds": Seeds,
        "merging": MergingEntry,
        "compare": CompareEntry,
        "adaptive": AdaptiveEntry,
        "resources": Resources,
        "environments": EnvironmentEntry,
        "inference": Inference,
    }
    model = models.get(str(place[0]), root) if len(place) > 1 else root
    return list(model.model_fields)


def _kind(value: Any) -> str:
    if value is None:
        return "nothing"
    names = {
        dict: "a mapping",
        list: "a list",
        str: "text",
        bool: "true/false",
        int: "a whole number",
        float: "a number",
    }
    name = names.get(type(value), type(value).__name__)
    return name if isinstance(value, dict | list) else f"{name} ({_shown(value)})"


def _shown(value: Any) -> str:
    return shortened(repr(value), LONGEST_VALUE)
