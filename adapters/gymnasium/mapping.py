"""Mapping files, which describe the numbers of gymnasium environments. Each YAML file is a task named like the file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from robogauntlet.adapters.contract import AdapterError, Goal, TaskDescription
from robogauntlet.adapters.gymnasium.expressions import LARGEST, check_attribute, check_expression, undeclared
from robogauntlet.suites.episode import CAMERAS, content_hash
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.ranges import MAX_STEPS, MAX_TEXT
from robogauntlet.suites.yaml_file import YamlError, parse_yaml, read_yaml
from robogauntlet.support.errors import first_line, plain_words
from robogauntlet.support.text import shortened, visible

LONGEST_MESSAGE = 300
"""Characters of a message about a mapping."""
FOLDERS = "ROBOGAUNTLET_GYMNASIUM"
"""Environment variable: folders with further mapping files, separated as in PATH. They replace shipped ones."""

Expression = Annotated[str, AfterValidator(check_expression)]
Vector = tuple[float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, str_max_length=MAX_TEXT)


class Drive(_Strict):
    """Adds `offset + scale * number` of an action to one number of the environment's action."""

    index: Annotated[int, Field(ge=0, le=LARGEST)]
    scale: float
    offset: float = 0.0


class Orbit(_Strict):
    """A free camera in a MuJoCo environment."""

    at: Expression | Vector
    """Centre of the image in the environment's world (m)."""
    distance: Annotated[float, Field(gt=0)]
    """Distance from the centre (m)."""
    azimuth: float
    """Viewing direction about the vertical (degrees); 0 is along the world's x."""
    elevation: float
    """Viewing direction upwards (degrees); -90 is straight down."""


class Cameras(_Strict):
    """In MuJoCo the name of a camera or an orbit; elsewhere `render`, for the image of the environment's `render`."""

    third_person: str | Orbit = "render"
    wrist: str | Orbit | None = None


class Base(_Strict):
    """The robot's base in the environment's world."""

    position: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    """Degrees about z."""


class MappedGoal(_Strict):
    """The fields of a `robogauntlet.adapters.contract.Goal`, in entries of the mapping's `state`."""

    entry: str
    to: str = ""
    offset: tuple[float, ...] = Goal.offset
    axes: str = Goal.axes
    tolerance: float = Goal.tolerance
    handle: str = ""
    grasped: bool = False

    @model_validator(mode="after")
    def _measurable(self) -> MappedGoal:
        self.goal()
        return self

    def goal(self) -> Goal:
        """Return the goal; raises ValueError if it cannot be measured."""
        return Goal(**self.model_dump())


class EnvironmentMapping(_Strict):
    """A mapping file."""

    env: str
    """Id for `gymnasium.make`; `package:Id` imports the package that registers it."""
    make: dict[str, Any] = {}
    """Further arguments for `gymnasium.make`."""
    instruction: Annotated[str, Field(min_length=1)]
    horizon: Annotated[int, Field(ge=1, le=MAX_STEPS)]
    control_hz: Annotated[float, Field(gt=0, le=1e6)]
    max_translation: Annotated[float, Field(ge=0)]
    """Largest translation of the tool per axis and step (m)."""
    max_rotation: Annotated[float, Field(ge=0)] = 0.0
    action: Annotated[dict[Literal["dx", "dy", "dz", "rx", "ry", "rz", "gripper"], Drive], Field(min_length=1)]
    """Numbers that are left out are ignored."""
    base: Base = Base()
    reads: tuple[Annotated[str, AfterValidator(check_attribute)], ...] = ()
    """Attributes of the environment without its wrappers that expressions read, such as `robot.position`."""
    state: dict[str, Expression | list[Expression | float]]
    """Privileged state, by the contract's names. Positions and orientations (matrices or quaternions xyzw) are
    converted to the base frame. Lists are concatenated; lists of plain numbers are not converted."""
    tool: Vector = (0.0, 0.0, 0.0)
    """Rotates `tcp_quaternion` so that z points out of the gripper and the fingers open along y: intrinsic Euler angles
    xyz (degrees)."""
    success: Expression
    goal: MappedGoal | None = None
    """What has to be achieved, from which progress and the kinds of failures are measured."""
    terminates: Literal[True] = True
    """Whether an episode ends where the environment ends it, as it always does: mappings may say so."""
    cameras: Cameras = Cameras()

    @model_validator(mode="after")
    def _declared(self) -> EnvironmentMapping:
        """Check that the attributes which the expressions read are declared."""
        places: dict[str, Any] = {f"state.{name}": source for name, source in self.state.items()}
        places["success"] = self.success
        for camera in ("third_person", "wrist"):
            if isinstance(source := getattr(self.cameras, camera), Orbit):
                places[f"cameras.{camera}.at"] = source.at
        for place, source in places.items():
            for text in source if isinstance(source, list | tuple) else [source]:
                if isinstance(text, str) and (path := undeclared(text, self.reads)):
                    raise ValueError(f"{place}: '{text}' reads '{path}' of the environment; add it to `reads`")
        return self

    @model_validator(mode="after")
    def _goal_in_state(self) -> EnvironmentMapping:
        """Check that the goal is one of entries of the state."""
        for field in ("entry", "to", "handle") if self.goal else ():
            name = getattr(self.goal, field)
            if name and name not in self.state:
                raise ValueError(f"goal.{field}: no '{name}' in `state`{did_you_mean(name, self.state)}")
        return self


def mapping_files() -> Iterator[tuple[str, Path]]:
    """Yield tasks and files, shipped ones first."""
    own = filter(None, os.environ.get(FOLDERS, "").split(os.pathsep))
    for folder in (Path(__file__).with_name("mappings"), *map(Path, own)):
        yield from ((path.stem, path) for path in sorted(folder.glob("*.yaml")))


def load_mapping(path: Path) -> EnvironmentMapping:
    """Read a mapping file.

    Raises:
        AdapterError: One line for each mistake.
    """
    try:
        document = parse_yaml(read_yaml(path, "a mapping file"))
        if document.duplicates:
            raise AdapterError(
                "\n".join(_in_a_line(path, f"line {line}: duplicate key '{key}'") for line, key in document.duplicates)
            )
        return EnvironmentMapping.model_validate(document.data)
    except ValidationError as error:
        raise AdapterError(
            "\n".join(dict.fromkeys(_in_a_line(path, _message(one)) for one in error.errors()))
        ) from None
    except YamlError as error:
        line = f", line {error.line}" if error.line else ""
        raise AdapterError(_in_a_line(path, f"not a mapping file{line}: {error}")) from None


def definition(path: Path) -> str:
    """Return the hash of a mapping file."""
    try:
        return content_hash(path.read_text(encoding="utf-8", errors="replace"))
    except OSError:
        return "cannot be read"


def load_description(path: Path) -> TaskDescription:
    """Return the description of a mapping file's task, or of the file's first mistake."""
    try:
        mapping = load_mapping(path)
    except AdapterError as error:
        return TaskDescription(f"cannot be opened: {first_line(error)}", 1)
    cameras = CAMERAS if mapping.cameras.wrist else CAMERAS[:1]
    module, colon, _ = mapping.env.partition(":")
    return TaskDescription(
        mapping.instruction,
        mapping.horizon,
        cameras=cameras,
        modules=(module,) if colon else (),
        goal=mapping.goal.goal() if mapping.goal else None,
    )


def _in_a_line(path: Path, message: str) -> str:
    return f"{path}: {shortened(visible(message), LONGEST_MESSAGE)}"


def _message(problem: Any) -> str:
    """Return one of pydantic's errors as a line."""
    if not problem["loc"] and problem["type"] == "value_error":
        return str(problem["ctx"]["error"])
    where = [str(part) for part in problem["loc"]] or ["file"]
    place = ".".join(where)
    match problem["type"]:
        case "extra_forbidden":
            models: dict[str, type[_Strict]] = {"base": Base, "action": Drive, "goal": MappedGoal, "cameras": Cameras}
            model = models.get(where[0], EnvironmentMapping) if len(where) > 1 else EnvironmentMapping
            return f"unknown key '{place}'{did_you_mean(where[-1], model.model_fields)}"
        case "missing":
            return f"missing key '{place}'"
        case "value_error":
            return f"{place}: {problem['ctx']['error']}"
        case _:
            return (
                f"{place}: {plain_words(problem['msg']).replace('Input should', 'should')}, found {problem['input']!r}"
            )


FILES = dict(mapping_files())
"""Task to its mapping file."""
