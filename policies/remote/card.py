"""What a suite says of a policy behind an address: how our observation is sent, and how the answer is to be read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from adapters.contract import ACTION_DIM
from policies.contract import PolicyError
from policies.remote import libero
from suites.vocabulary import CAMERAS, content_hash

NAME = "openpi"
CAMERA_KEYS = dict(zip(CAMERAS, ("observation/image", "observation/wrist_image"), strict=True))
STATE_KEY, INSTRUCTION_KEY, ACTIONS_KEY = "observation/state", "prompt", "actions"
Key = Annotated[str, Field(min_length=1, max_length=200)]
Seconds = Annotated[float, Field(gt=0, le=3600)]
Size = Annotated[int, Field(strict=True, ge=16, le=1024)]


class Convention(BaseModel):
    """How an observation is given to somebody else's policy, and how its answer is to be read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    convention: Literal["robogauntlet", "libero"] = "robogauntlet"
    """What observation and answer mean: ours, or that of policies trained on LIBERO's data (`policies.remote.libero`),
    which then says `turn`, `rotation` and the scales."""

    cameras: dict[str, Key] = Field(default=CAMERA_KEYS)
    """Camera to the server's key."""
    proprioception: Key | None = STATE_KEY
    instruction: Key | None = INSTRUCTION_KEY
    image_size: Size | tuple[Size, Size] | None = None
    """Pixels, or height and width; None to send what is rendered."""
    resize: Literal["pad", "stretch"] = "pad"
    turn: Literal["none", "half", "left-right", "upside-down"] = "none"
    """What becomes of each image before it is resized: nothing, half a turn, or a mirroring."""

    actions: Key = ACTIONS_KEY
    columns: tuple[Annotated[int, Field(strict=True, ge=0, le=255)] | None, ...] | None = None
    """Where in a row of the answer our seven numbers stand (eight with a quaternion), None for one that is always 0."""
    translation_scale: float = 1.0
    """Metres per unit of the answer."""
    rotation: Literal["axis-angle", "euler", "quaternion-xyzw", "quaternion-wxyz"] = "axis-angle"
    """How the answer's rotations are written, which turn the tool in the base frame: as axis-angle vectors, as Euler
    angles about the fixed axes x, y and z in this order, or as quaternions."""
    rotation_scale: float = 1.0
    """Radians per unit of the answer; none for quaternions, which have no unit."""
    gripper_open: float = -1.0
    gripper_closed: float = 1.0
    gripper_threshold: float | None = None
    execute: Annotated[int, Field(strict=True, ge=1, le=1000)] | None = None

    @model_validator(mode="after")
    def _sound(self) -> Self:
        unknown = [camera for camera in self.cameras if camera not in CAMERAS]
        if unknown or not (self.cameras or "cameras" not in self.model_fields_set):
            raise ValueError(f"cameras: expected some of {', '.join(CAMERAS)}, got {', '.join(unknown) or 'none'}")
        keys = [key for key in (*self.cameras.values(), self.proprioception, self.instruction) if key is not None]
        if len(set(keys)) < len(keys):
            raise ValueError(f"expected another key for each part of the observation, got {', '.join(keys)}")
        if self.columns is not None and len(self.columns) != self.width:
            kind = "" if self.width == ACTION_DIM else f" for a {self.rotation}"
            raise ValueError(f"columns: expected {self.width} places{kind}, got {len(self.columns)}")
        if self.turns_by_quaternion and self.columns is not None and set(self.columns[3:7]) == {None}:
            raise ValueError("columns: a quaternion is never all 0; leave out rotations by rotation: axis-angle")
        if self.turns_by_quaternion and self.rotation_scale != 1.0:
            raise ValueError(f"rotation_scale: quaternions have no unit, expected 1, got {self.rotation_scale}")
        said = sorted(self.model_fields_set & libero.OPTIONS.keys())
        if self.convention == "libero" and said:
            raise ValueError(f"expected no {' and no '.join(said)}, which convention libero says")
        if self.gripper_open == self.gripper_closed:
            raise ValueError(f"expected gripper_open other than gripper_closed, got {self.gripper_open} for both")
        return self

    def spelled_out(self) -> Self:
        """The same with what its convention says of the other options."""
        return self.model_copy(update=libero.OPTIONS) if self.convention == "libero" else self

    @property
    def turns_by_quaternion(self) -> bool:
        """Whether the answer's rotations are quaternions."""
        return self.rotation.startswith("quaternion")

    @property
    def width(self) -> int:
        """How many of a row's numbers are read."""
        return ACTION_DIM + 1 if self.turns_by_quaternion else ACTION_DIM


class Card(Convention):
    """The options of the kind `openpi`."""

    address: str
    """`ws://HOST:PORT` or `wss://HOST`; `openpi://HOST:PORT` and `HOST:PORT` mean `ws://`."""
    identity: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """What acts there, such as a checkpoint's name or hash."""

    connect_timeout_s: Seconds = 10.0
    timeout_s: Seconds = 60.0
    retries: Annotated[int, Field(strict=True, ge=0, le=1000)] = 3
    token_variable: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")] | None = None
    token_scheme: Literal["Bearer", "Api-Key"] = "Bearer"

    @field_validator("address")
    @classmethod
    def _websocket(cls, value: str) -> str:
        scheme, separator, rest = value.partition("://")
        if not separator:
            scheme, rest = "ws", value
        scheme = "ws" if scheme == NAME else scheme
        try:
            parts = urlsplit(f"{scheme}://{rest}")
            sound = scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0 and parts.username is None
        except ValueError:
            sound = False
        if not sound or any(character.isspace() for character in value):
            raise ValueError(f"expected ws://HOST:PORT, got '{value}'")
        return f"{scheme}://{rest}"

    @property
    def is_plain(self) -> bool:
        """Whether nothing is said of how to send and to read, so that RoboGauntlet's own server is asked as it is."""
        return not self.model_fields_set - {"address", "identity", *_HOW}

    def declaration(self) -> dict[str, Any]:
        """What decides how the policy acts, as plain values: all but where it is and how long to wait for it."""
        said = self.model_dump(mode="json", exclude={"address", "identity", *_HOW})
        return {name: value for name, value in said.items() if (name, value) not in _LATER}

    def digest(self, who: object) -> str:
        """Hash of the policy's content. Args: who: what acts there, as plain values."""
        return content_hash({"policy": NAME, "card": self.declaration(), "who": who})


_HOW = ("connect_timeout_s", "timeout_s", "retries", "token_variable", "token_scheme")
_LATER = (("convention", "robogauntlet"), ("turn", "none"), ("rotation", "axis-angle"))
"""Defaults of options that came later: without them, the hash of a policy that does not use them stays what it was."""
CONVENTION_OPTIONS = {
    "convention": "robogauntlet, or libero for policies trained on LIBERO's own data",
    "cameras": "camera to the server's key",
    "proprioception": "key of the eight numbers; null to leave them out",
    "instruction": "key of the goal in words; null to leave it out",
    "image_size": "px, or [height, width]; by default as rendered",
    "resize": "pad (keeps the shape) or stretch",
    "turn": "none, half (180 degrees), left-right or upside-down: what becomes of images before they are sent",
    "actions": "key of the chunk in the answer",
    "columns": "columns of the answer for dx dy dz rx ry rz gripper (with a quaternion four, not three); null for 0",
    "translation_scale": "metres per unit of the answer",
    "rotation": "axis-angle, euler (fixed axes x, y, z), quaternion-xyzw or quaternion-wxyz",
    "rotation_scale": "radians per unit of the answer",
    "gripper_open": "the answer's number for open",
    "gripper_closed": "the answer's number for closed",
    "gripper_threshold": "beyond this number, seen from open, the gripper closes, else it opens; by default in between",
    "execute": "actions of a chunk that are executed at most; fewer in an answer are an error",
}
OPTIONS = {
    "address": "ws://HOST:PORT, wss://HOST, or openpi://HOST:PORT",
    "identity": "what acts there (a checkpoint's name or hash); by default what the server says on connection",
    **CONVENTION_OPTIONS,
    "connect_timeout_s": "seconds to wait for a connection",
    "timeout_s": "seconds to wait for an answer, reconnections included",
    "retries": "times that a lost connection is made again for one query",
    "token_variable": "environment variable that holds a token for the server",
    "token_scheme": "Bearer or Api-Key",
}
"""Option to what it means."""


def read_card(options: Mapping[str, Any]) -> Card:
    """The options of a suite.

    Raises:
        PolicyError: One is missing, or is not what it should be; in one line.
    """
    try:
        card = Card.model_validate(dict(options))
    except ValidationError as error:
        fault = first_fault(error).removeprefix("all of it: ").replace("Value error, ", "")
        raise PolicyError(f"policy '{NAME}': {' '.join(fault.split())}") from None
    return card.spelled_out()


def first_fault(error: ValidationError) -> str:
    """The first thing that is wrong, in one line."""
    fault = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, fault['loc'])) or 'all of it'}: {fault['msg']}"
