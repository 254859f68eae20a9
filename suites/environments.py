"""Definitions of Python environments for simulators, in suites and in the user's configuration."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from robogauntlet.suites.episode import content_hash


def _version(value: Any) -> Any:
    text = str(value)  # YAML reads 3.11 as a number, and 3.10 as 3.1, which is refused.
    if not re.fullmatch(r"3\.1[0-9]", text):
        raise ValueError('expected a version such as "3.11", in quotes')
    return text


def _requirement(value: str) -> str:
    from packaging import requirements

    expected = "expected a requirement of pip, such as robosuite==1.4.0, and no option"
    if not value.strip() or value.startswith("-") or "\n" in value:
        raise ValueError(expected)
    if "/" not in value and value != ".":  # a folder or a URL is pip's to judge
        try:
            requirements.Requirement(value)
        except requirements.InvalidRequirement:
            raise ValueError(f"{expected}, got '{value}'") from None
    return value


def _path(value: str, what: str = "a Python interpreter") -> str:
    if not value.startswith(("/", "~/")):
        raise ValueError(f"expected the full path of {what}")
    return value


def _folder(value: str) -> str:
    return _path(value, "a folder")


Requirement = Annotated[str, Field(strict=True), AfterValidator(_requirement)]


class EnvironmentEntry(BaseModel):
    """A Python environment: one that `robogauntlet env create` creates, or an existing one."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    python: Annotated[str, BeforeValidator(_version)] | None = None
    """Version of Python, such as "3.11"; by default the running one, which Ray requires of all workers."""
    requirements: tuple[Requirement, ...] = ()
    """Requirements of pip: `robosuite==1.4.0`, a URL, a folder."""
    without_dependencies: tuple[Requirement, ...] = ()
    """Installed after the others, without their dependencies."""
    inherit: bool = True
    """Whether the running environment's packages are visible behind the environment's own."""
    installer: Literal["pip", "uv"] = "pip"
    interpreter: Annotated[str, Field(strict=True), AfterValidator(_path)] | None = None
    """Path of the Python of an existing environment, instead of all of the above."""

    @model_validator(mode="after")
    def _one_or_the_other(self) -> EnvironmentEntry:
        if self.interpreter is not None and self.model_fields_set - {"interpreter"}:
            raise ValueError("expected an interpreter alone, or a definition without one")
        if self.installer == "uv" and self.inherit:
            raise ValueError("expected inherit: false with uv, which ignores inherited packages")
        return self

    @property
    def hash(self) -> str:
        """Hash of the definition, the same on every machine."""
        return content_hash(self.model_dump(exclude_defaults=True), length=12)


class Config(BaseModel):
    """The content of the user's configuration file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    environments: dict[str, EnvironmentEntry] = Field(default_factory=dict)
    """Simulator to its Python environment, unless the suite defines another."""
    assets: dict[str, Annotated[str, Field(strict=True), AfterValidator(_folder)]] = Field(default_factory=dict)
    """Simulator to the folder of its assets, unless the environment has a variable for it."""
