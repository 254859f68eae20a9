"""What a suite or the user's configuration says of the Python environment that a simulator runs in. Starts nothing."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from robogauntlet.suites.episode import content_hash


def _version(value: Any) -> Any:
    """YAML reads 3.11 as a number, and 3.10 as 3.1, which is refused."""
    text = str(value)
    if not re.fullmatch(r"3\.\d{2}", text):
        raise ValueError('expected a version such as "3.11", in quotes')
    return text


def _requirement(value: str) -> str:
    if not value.strip() or value.startswith("-") or "\n" in value:
        raise ValueError("expected what pip installs, such as robosuite==1.4.0, and no option")
    return value


def _path(value: str) -> str:
    if not value.startswith(("/", "~/")):
        raise ValueError("expected the full path of a Python")
    return value


Requirement = Annotated[str, Field(strict=True), AfterValidator(_requirement)]


class EnvironmentEntry(BaseModel):
    """A Python environment: either one that `robogauntlet env create` makes, or one that is there."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    python: Annotated[str, BeforeValidator(_version)] | None = None
    """Version of Python, as "3.11"; by default the running one, which Ray asks of all its workers."""
    requirements: tuple[Requirement, ...] = ()
    """As pip takes them: `robosuite==1.4.0`, a URL, a folder."""
    without_dependencies: tuple[Requirement, ...] = ()
    """Installed after the others, and without what they name as their dependencies."""
    inherit: bool = True
    """Whether the running environment's packages are seen behind the environment's own."""
    installer: Literal["pip", "uv"] = "pip"
    interpreter: Annotated[str, Field(strict=True), AfterValidator(_path)] | None = None
    """Path of the Python of an environment that is there already, instead of all of the above."""

    @model_validator(mode="after")
    def _one_or_the_other(self) -> EnvironmentEntry:
        if self.interpreter is not None and self.model_fields_set - {"interpreter"}:
            raise ValueError("expected an interpreter alone, or what an environment is to be made of")
        if self.installer == "uv" and self.inherit:
            raise ValueError("expected inherit: false with uv, which does not see inherited packages")
        return self

    @property
    def hash(self) -> str:
        """Of the content, the same on every machine."""
        return content_hash(self.model_dump(exclude_defaults=True), length=12)


class Config(BaseModel):
    """What the user's configuration file says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    environments: dict[str, EnvironmentEntry] = Field(default_factory=dict)
    """Simulator to the Python environment that it runs in, in all suites that say nothing else."""
