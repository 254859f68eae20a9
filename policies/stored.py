"""Values that are read from a file or a suite and written back, checked by pydantic."""

from __future__ import annotations

import reprlib
from typing import Any, ClassVar, Self

from pydantic import ConfigDict, TypeAdapter, ValidationError

from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.errors import plain_words

STRICT = ConfigDict(extra="forbid")
"""Configuration of pydantic dataclasses that refuse unknown fields."""


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
    place = ".".join(map(str, fault["loc"]))
    message = " ".join(plain_words(fault["msg"]).split())
    if message.startswith("Input should be "):
        message = f"expected {message.removeprefix('Input should be ')}, got {reprlib.repr(fault['input'])}"
    return f"{place}: {message}" if place else message
