"""The only reader of YAML. Files may come from strangers: size, number of values and nesting are bounded."""

from __future__ import annotations

import contextlib
import os
import re
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml

from robogauntlet.support.errors import first_line
from robogauntlet.support.files import open_regular

MAX_BYTES = 1_000_000
MAX_VALUES = 100_000
MAX_DEPTH = 50
"""Lists and mappings inside each other."""
MAX_DIGITS = 100
"""Characters of a number."""
DATE = "tag:yaml.org,2002:timestamp"
_OCTAL = re.compile(r"[-+]?0[0-9_]+")
_TAKEN_OTHERWISE = re.compile(r"[^ -~\n]|[?|>%]|^(---|[.]{3})", re.MULTILINE)
"""What libyaml takes at places where Python's own parser does not, or counts as another line."""
NUMBERS = frozenset({"tag:yaml.org,2002:int", "tag:yaml.org,2002:float"})

Place = tuple[str | int, ...]
"""Keys and list indices of a value in the file."""


class YamlError(ValueError):
    """Text that is not plain YAML within the bounds. The message is one line; `line` is its place, from 1, or None."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


@dataclass(frozen=True)
class Document:
    """The values of a YAML text."""

    data: Any
    """None, numbers, text, lists and mappings."""
    lines: dict[Place, int] = field(default_factory=dict)
    """The line of each place, from 1."""
    duplicates: tuple[tuple[int, str], ...] = ()
    """Line and name of each key that a mapping has already."""


def read_yaml(path: Path, what: str) -> str:
    """Return the text of a YAML file.

    Args:
        path: The file.
        what: What is expected there, for messages: `a suite file`.

    Raises:
        YamlError: It cannot be read, is too long, or is not UTF-8.
    """
    try:
        if path.is_dir():
            raise YamlError(f"expected {what}, this is a directory")
        if str(path) == os.devnull:  # named in place of a configuration to have none
            return ""
        with open_regular(path) as file:
            raw = file.read(MAX_BYTES + 1)
        if len(raw) > MAX_BYTES:
            raise YamlError(f"expected {what} of at most {MAX_BYTES} bytes, this has {_size(path)}")
        return raw.decode("utf-8")
    except FileNotFoundError:
        near = get_close_matches(path.stem, [p.stem for p in path.parent.glob("*.yaml")], n=1)
        raise YamlError(f"no such file{f'; did you mean {path.parent / near[0]}.yaml?' if near else ''}") from None
    except OSError as error:
        raise YamlError(f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        raise YamlError(f"expected UTF-8 text, found byte 0x{byte:02x} at offset {error.start}") from None
    except ValueError as error:  # a path with a NUL character
        raise error if isinstance(error, YamlError) else YamlError(f"cannot be read: {error}") from None


def parse_yaml(text: str) -> Document:
    """Return the values of a YAML text of one document.

    Raises:
        YamlError: It is not YAML, has tags, aliases or dates, or exceeds the bounds.
    """
    if yaml.__with_libyaml__ and not _TAKEN_OTHERWISE.search(text):
        with contextlib.suppress(yaml.YAMLError, ValueError, OverflowError):  # Python's own parser says what is wrong
            return _read(_FastLoader(text))
    try:
        return _read(_Loader(text))
    except yaml.constructor.ConstructorError as error:
        raise YamlError(str(error.problem), _line(error.problem_mark)) from None
    except yaml.MarkedYAMLError as error:
        raise YamlError(f"not YAML: {error.problem}", _line(error.problem_mark)) from None
    except yaml.reader.ReaderError as error:
        found = f"U+{error.character:04X}" if isinstance(error.character, int) else repr(error.character)
        raise YamlError(f"not YAML: character {found} at offset {error.position}, expected printable text") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise error if isinstance(error, YamlError) else YamlError(f"not YAML: {first_line(error)}") from None


def _read(loader: _Loader | _FastLoader) -> Document:
    """Raises yaml.YAMLError, ValueError, OverflowError."""
    try:
        node = loader.get_single_node()
        if node is None:
            return Document(None)
        lines: dict[Place, int] = {}
        duplicates: list[tuple[int, str]] = []
        _index(node, (), lines, duplicates)
        return Document(loader.construct_document(node), lines, tuple(duplicates))
    finally:
        loader.dispose()


class _Bounded(yaml.composer.Composer):
    """Refuses nesting, numbers of values, numbers and characters beyond the bounds while it reads."""

    _depth = _values = 0
    line = 0
    """That which is being read, from 0."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        self._depth, self._values = self._depth + 1, self._values + 1
        if self._depth > MAX_DEPTH:
            raise YamlError(f"expected at most {MAX_DEPTH} lists and mappings inside each other", self.line + 1)
        if self._values > MAX_VALUES:
            raise YamlError(f"expected at most {MAX_VALUES} values", self.line + 1)
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise YamlError(f"expected plain YAML without aliases, found *{event.anchor}", _line(event.start_mark))
        if tag := getattr(event, "tag", None):
            raise YamlError(f"expected plain YAML without tags, found the tag '{tag}'", _line(event.start_mark))
        node = super().compose_node(parent, index)
        self._depth -= 1
        _check(node)
        return node


class _Loader(_Bounded, yaml.SafeLoader):
    """Python's own, whose messages are shown."""


if yaml.__with_libyaml__:

    class _FastLoader(_Bounded, yaml.cyaml.CParser, yaml.constructor.SafeConstructor, yaml.resolver.Resolver):
        """The same from the events of libyaml's parser, in a third of the time."""

        def __init__(self, text: str) -> None:
            yaml.cyaml.CParser.__init__(self, text)
            for part in (_Bounded, yaml.constructor.SafeConstructor, yaml.resolver.Resolver):
                part.__init__(self)


def _check(node: yaml.Node) -> None:
    line = _line(node.start_mark)
    if node.tag == DATE:
        raise YamlError(f"expected plain YAML, found a date ('{node.value}'); put it in quotes", line)
    if not isinstance(node, yaml.ScalarNode):
        return
    if node.tag in NUMBERS and len(node.value) > MAX_DIGITS:
        raise YamlError(f"expected a number of at most {MAX_DIGITS} characters, found {len(node.value)}", line)
    if node.tag in NUMBERS and (":" in node.value or _OCTAL.fullmatch(node.value)):
        raise YamlError(f"expected a decimal number, or text in quotes; found {node.value}, which YAML converts", line)
    if (wrong := next((c for c in node.value if c == "\0" or "\ud800" <= c <= "\udfff"), None)) is not None:
        raise YamlError(f"expected text that UTF-8 can write, found the character U+{ord(wrong):04X}", line)


def _index(node: yaml.Node, place: Place, lines: dict[Place, int], duplicates: list[tuple[int, str]]) -> None:
    """Add the line of each place below a node, and the keys that occur twice."""
    lines.setdefault(place, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            name = key.value if isinstance(key, yaml.ScalarNode) else str(key.tag)
            line = lines[(*place, name)] = key.start_mark.line + 1
            if name in seen:
                duplicates.append((line, name))
            seen.add(name)
            _index(value, (*place, name), lines, duplicates)
    elif isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            _index(item, (*place, i), lines, duplicates)


def _line(mark: Any) -> int | None:
    return mark.line + 1 if mark else None


def _size(path: Path) -> str:
    size = path.stat().st_size
    return str(size) if size > MAX_BYTES else "more"  # a device has no size
