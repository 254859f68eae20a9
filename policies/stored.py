"""Values that are read from a file or a suite and written back, checked by pydantic."""

from __future__ import annotations

import reprlib
from typing import Any, ClassVar, Self

from pydantic import ConfigDict, TypeAdapter, ValidationError

from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.errors import plain_words
from robogauntlet.support.text import shortened, visible

LONGEST_PLACE = 200
"""Characters of the place of a fault, which may hold names of strangers."""
STRICT = ConfigDict(extra="forbid")
"""Configuration of pydantic dataclasses that refuse unknown fields."""


class StoredError(PolicyError):
    """A file or stored value that cannot be used. Its text is one line, whatever names the file holds."""

    def __init__(self, message: str) -> None:
        super().__init__(visible(message))


class Stored:
    """Base of frozen pydantic dataclasses that are stored as JSON."""

    what: ClassVar[str]
    """First words of an error message."""
    refusal: ClassVar[type[PolicyError]]

    def as_json(self) -> dict[str, Any]:
        """Return the value as plain JSON; `from_json` is the inverse."""
        plain: dict[str, Any] = TypeAdapter(type(self)).dump_python(self, mode="json")
        return plain

    @classmethod
    def from_json(cls, plain: Any) -> Self:
        """Read what `as_json` wrote. Raises `refusal` for unknown, missing or invalid fields."""
        try:
            return TypeAdapter(cls).validate_python(plain)
        except ValidationError as error:
            raise cls.refusal(f"{cls.what}: {first_fault(error)}") from None


def first_fault(error: ValidationError) -> str:
    """Return the first error in one line."""
    fault = error.errors(include_url=False)[0]
    place = shortened(visible(".".join(map(str, fault["loc"]))), LONGEST_PLACE)
    message = " ".join(plain_words(fault["msg"]).split())
    if message.startswith("Input should be "):
        message = f"expected {message.removeprefix('Input should be ')}, got {reprlib.repr(fault['input'])}"
    return f"{place}: {message}" if place else message
