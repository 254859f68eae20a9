"""The options of a policy behind a server: the conversion of observations and answers, and the connection."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Literal, Self
from urllib.parse import urlsplit

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator, model_validator

from robogauntlet.adapters.contract import ACTION_DIM, Moves
from robogauntlet.policies.contract import PolicyError, Wishes
from robogauntlet.policies.remote.presets import OPENPI_KEYS, PRESETS
from robogauntlet.policies.stored import first_fault
from robogauntlet.suites.episode import CAMERAS, content_hash
from robogauntlet.support.network import is_loopback
from robogauntlet.support.secret_variables import POLICY_TOKEN


class WireProtocol(StrEnum):
    """A protocol of policy servers and their clients."""

    OPENPI = "openpi"
    VLA_EVAL = "vla-eval"


ENCRYPTED = ("wss", "https")
"""Schemes over which a token may leave this machine."""
_TOKEN_VARIABLE = re.compile(rf"{POLICY_TOKEN}(_[A-Z0-9_]{{1,60}})?")
CAMERA_KEYS = dict(zip(CAMERAS, ("observation/image", "observation/wrist_image"), strict=True))
STATE_KEY, INSTRUCTION_KEY, ACTIONS_KEY = "observation/state", "prompt", "actions"
VLA_EVAL_CAMERAS = dict(zip(CAMERAS, ("agentview", "wrist"), strict=True))
VLA_EVAL_STATE, VLA_EVAL_INSTRUCTION = "state", "task_description"
Key = Annotated[str, Field(min_length=1, max_length=200)]
Seconds = Annotated[float, Field(gt=0, le=3600)]
Size = Annotated[int, Field(strict=True, ge=16, le=1024)]
Column = Annotated[int, Field(strict=True, ge=0, le=255)]
TURNS = {"none": (1, 1), "half": (-1, -1), "left-right": (1, -1), "upside-down": (-1, 1)}
"""Name of a turn to the strides through an image's rows and columns."""
OF_TOOLS = {"translation_scale", "rotation", "rotation_scale"}
"""Options that have no meaning for joints."""
NATIVE = "native"
"""Convention of policies whose numbers are the environment's own."""
UNITS = ("translation_scale", "rotation", "rotation_scale", "gripper_open", "gripper_closed")
"""Options that say what the numbers of a moved tool mean."""
GRIPPER_RANGE = {"gripper_open", "gripper_closed"}
"""Options without a default beside joints."""
OF_ROBOTS = {*OF_TOOLS, *GRIPPER_RANGE, "gripper_threshold", "joints", "arms", "joint_scale", "velocity_scale"}
"""Options that have no meaning for native numbers."""


def _turns(value: object) -> object:
    """A turn of all images, or camera to turn. Raises ValueError for another."""
    given = value if isinstance(value, Mapping) else dict.fromkeys(CAMERAS, value)
    if not given or any(not isinstance(turn, str) or turn not in TURNS for turn in given.values()):
        *names, last = TURNS
        raise ValueError(f"expected {', '.join(names)} or {last}, or one for each camera, got {reprlib.repr(value)}")
    if unknown := [camera for camera in given if camera not in CAMERAS]:
        raise ValueError(f"expected some of {', '.join(CAMERAS)}, got {reprlib.repr(unknown[0])}")
    turns = {camera: given.get(camera, "none") for camera in CAMERAS}
    return turns if len(set(turns.values())) > 1 else turns[CAMERAS[0]]  # one hash for one meaning


def _state_keys(value: object) -> object:
    """A key, or key to columns. Raises ValueError for another."""
    columns = [*value.values()] if isinstance(value, Mapping) else []
    sound = bool(columns) and all(isinstance(own, list | tuple) and own for own in columns)
    if not isinstance(value, str | None) and not (sound and {type(one) for own in columns for one in own} == {int}):
        raise ValueError(f"expected a key, or keys with columns such as {{state: [0, 1]}}, got {reprlib.repr(value)}")
    return value


def _chunk_keys(value: object) -> object:
    """A key, or a list of keys. Raises ValueError for another."""
    keys = [value] if isinstance(value, str) else value
    if not isinstance(keys, list | tuple) or not keys or len({*map(str, keys)}) < len(keys):
        raise ValueError(f"expected a key, or a list of different keys, got {reprlib.repr(value)}")
    return value


StateKeys = Annotated[Key | dict[Key, tuple[Column, ...]] | None, BeforeValidator(_state_keys)]
ChunkKeys = Annotated[Key | tuple[Key, ...], BeforeValidator(_chunk_keys)]


class Convention(BaseModel):
    """Conversion of observations for an external policy, and of its answers.

    The fields' docstrings are shown to users as the options' meaning.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)

    convention: Literal["robogauntlet", "libero", "so101", "aloha", "droid", "native"] = "robogauntlet"
    """robogauntlet, or libero for policies trained on LIBERO's own data, which sets turn, rotation and the scales, or
    so101 for LeRobot's SO-100 and SO-101 in degrees, which sets joints, joint_scale and the gripper's numbers, or aloha
    for gym-aloha's, which sets joints, arms, resize and the gripper's numbers, or droid for openpi's of DROID, which
    sets joints, velocity_scale and the gripper's numbers, or native for tasks such as gymnasium/PushT-v0, whose numbers
    are the environment's own: all are sent as they are"""
    cameras: dict[str, Key] = Field(default=CAMERA_KEYS)
    """camera to the server's key"""
    proprioception: StateKeys = STATE_KEY
    """key of the eight numbers, or of joints and gripper; or several keys, each with the columns that it gets; null to
    leave them out"""
    instruction: Key | None = INSTRUCTION_KEY
    """key of the goal in words; null to leave it out"""
    image_size: Size | tuple[Size, Size] | None = None
    """px, or [height, width], in which frames are rendered unless the suite states another; by default as rendered"""
    resize: Literal["pad", "stretch", "crop"] = "pad"
    """pad (keeps the shape), stretch, or crop (keeps the shape, fills another by the middle)"""
    turn: Annotated[str | dict[str, str], BeforeValidator(_turns)] = "none"
    """none, half (180 degrees), left-right or upside-down: how images are turned before they are resized and sent; or
    one for each camera, such as {third_person: left-right, wrist: none}"""
    actions: ChunkKeys = ACTIONS_KEY
    """key of the chunk in the answer, or a list of keys whose columns are put side by side"""
    columns: tuple[Column | None, ...] | None = None
    """columns of the answer for dx dy dz rx ry rz gripper (with a quaternion four, not three), or joints and gripper;
    null for 0"""
    translation_scale: float = 1.0
    """metres per unit of the answer"""
    rotation: Literal["axis-angle", "euler", "quaternion-xyzw", "quaternion-wxyz"] = "axis-angle"
    """axis-angle, euler (fixed axes x, y, z), quaternion-xyzw or quaternion-wxyz; turns the tool in the base frame"""
    rotation_scale: float = 1.0
    """radians per unit of the answer; 1 for quaternions"""
    gripper_open: float = -1.0
    """the answer's number for open"""
    gripper_closed: float = 1.0
    """the answer's number for closed"""
    gripper_threshold: float | None = None
    """beyond this number, seen from open, the gripper closes, else it opens; by default it also stops in between"""
    joints: Annotated[int, Field(strict=True, ge=1, le=32)] | None = None
    """number of joints whose targets or velocities the answer has before that of the gripper, and whose angles are sent
    in place of the eight numbers; by default the answer moves the tool"""
    arms: Literal[1, 2] = 1
    """arms, each with its joints and gripper in the answer and in what is sent; 2 beside joints only"""
    joint_scale: float | tuple[float, ...] = 1.0
    """radians per unit of a joint, in the answer and in what is sent: of all, or a list"""
    velocity_scale: float | tuple[float, ...] | None = None
    """radians per second and unit, if the answer has velocities of joints: of all, or a list; by default targets"""
    execute: Annotated[int, Field(strict=True, ge=1, le=1000)] | None = None
    """actions of a chunk that are executed, unless the suite states a smaller replan_every; fewer in an answer are an
    error"""

    @model_validator(mode="after")
    def _sound(self) -> Self:
        unknown = [camera for camera in self.cameras if camera not in CAMERAS]
        if unknown or not (self.cameras or "cameras" not in self.model_fields_set):
            raise ValueError(f"cameras: expected some of {', '.join(CAMERAS)}, got {', '.join(unknown) or 'none'}")
        for keys in self._keys_beside_each_other():
            if len(set(keys)) < len(keys):
                raise ValueError(f"expected another key for each part of the observation, got {', '.join(keys)}")
        if self.is_native and (of_robots := sorted(self.model_fields_set & OF_ROBOTS)):
            raise ValueError(f"expected no {' and no '.join(of_robots)} beside convention native")
        joints = self.width // self._arms - 1 if self.has_joints else 0
        if self.arms > 1 and not joints:
            raise ValueError(f"arms: expected joints, their number, beside it, got {self.arms} without")
        if self.columns is not None and len(self.columns) != self.width and not self.is_native:
            kind = (
                " for joints and gripper" if joints else f" for a {self.rotation}" if self.turns_by_quaternion else ""
            )
            raise ValueError(f"columns: expected {self.width} places{kind}, got {len(self.columns)}")
        if self.turns_by_quaternion and self.columns is not None and set(self.columns[3:7]) == {None}:
            raise ValueError("columns: a quaternion is never all 0; leave out rotations by rotation: axis-angle")
        if self.turns_by_quaternion and self.rotation_scale != 1.0:
            raise ValueError(f"rotation_scale: quaternions have no unit, expected 1, got {self.rotation_scale}")
        if conflicting := sorted(self._own & PRESETS.get(self.convention, {}).keys()):
            raise ValueError(f"expected no {' and no '.join(conflicting)}, which convention {self.convention} sets")
        if joints and (of_tools := sorted(self.model_fields_set & OF_TOOLS)):
            raise ValueError(f"expected no {' and no '.join(of_tools)} beside joints, whose targets are no motion")
        for name, scale in (("joint_scale", self.joint_scale), ("velocity_scale", self.velocity_scale)):
            if not joints and name in self.model_fields_set:
                raise ValueError(f"{name}: expected joints, their number, beside it")
            scales = np.ravel(1.0 if scale is None else scale)
            if not scales.all() or len(scales) not in (1, joints):
                given = scales.tolist()
                raise ValueError(f"{name}: expected a number other than 0, or one for each of joints, got {given}")
        if self.gripper_open == self.gripper_closed:
            raise ValueError(f"expected gripper_open other than gripper_closed, got {self.gripper_open} for both")
        if self.joints and (missing := sorted(GRIPPER_RANGE - self.model_fields_set)):
            raise ValueError(f"expected {' and '.join(missing)} beside joints, whose gripper has no common range")
        return self

    def _keys_beside_each_other(self) -> list[list[str]]:
        """The keys of what is sent, in lists of which each must have no key twice."""
        state = self.proprioception_keys or {}
        return [[*self.cameras.values(), *state, *filter(None, [self.instruction])]]

    @property
    def proprioception_keys(self) -> Mapping[str, tuple[int, ...] | None] | None:
        """Key to the columns of the proprioception that it gets, None for all of them; None if none is sent."""
        return {self.proprioception: None} if isinstance(self.proprioception, str) else self.proprioception

    def unsaid(self) -> list[str]:
        """Return the options that say what the answer's numbers mean and are left to their defaults.

        A protocol that does not say it either refuses to guess, as wrong ones raise no error.
        """
        if self.joints or "convention" in self.model_fields_set:
            return []
        names = [name for name in UNITS if name != "rotation_scale" or not self.turns_by_quaternion]
        return [name for name in names if name not in self.model_fields_set]

    def resolved(self) -> Self:
        """Return a copy with the options that its convention sets."""
        preset = {name: value for name, value in PRESETS.get(self.convention, {}).items() if name not in self._instead}
        openpis = type(self).model_fields["cameras"].default == CAMERA_KEYS
        keys = OPENPI_KEYS.get(self.convention, {}) if openpis else {}
        return self.model_copy(update={**{name: keys[name] for name in keys.keys() - self._own}, **preset})

    @property
    def _own(self) -> set[str]:
        """The given options, but for those that may take the place of a convention's."""
        return self.model_fields_set - self._instead

    @property
    def _instead(self) -> set[str]:
        """Of the given ones, a turn of each camera, where a convention's is one of all, and targets for velocities."""
        given = {"turn": isinstance(self.turn, dict), "velocity_scale": self.velocity_scale is None}
        return {name for name in self.model_fields_set if given.get(name)}

    def turn_of(self, camera: str) -> tuple[int, int]:
        """Return the strides through the rows and columns of a camera's images."""
        return TURNS[self.turn[camera] if isinstance(self.turn, dict) else self.turn]

    @property
    def is_native(self) -> bool:
        """Whether numbers are the environment's own."""
        return self.convention == NATIVE

    @property
    def has_joints(self) -> bool:
        """Whether the answer has targets of joints, by option or convention."""
        return bool(self.joints or "joints" in PRESETS.get(self.convention, {}))

    @property
    def moves(self) -> Moves:
        """What the answer's numbers before the gripper's are."""
        if not self.has_joints:
            return Moves.NATIVE if self.is_native else Moves.TOOL
        velocities = self.velocity_scale or "velocity_scale" in PRESETS.get(self.convention, {}).keys() - self._instead
        return Moves.VELOCITIES if velocities else Moves.TARGETS

    @property
    def wishes(self) -> Wishes:
        """What the policy asks of a suite."""
        size = self.image_size
        if isinstance(size, tuple):
            size = min(size) if self.resize == "pad" else max(size)
        return Wishes(size, self.execute)

    @property
    def turns_by_quaternion(self) -> bool:
        """Whether the answer's rotations are quaternions."""
        return self.rotation.startswith("quaternion")

    @property
    def action_dim(self) -> int | None:
        """Numbers of an action, as a task accepts them; None for native ones, of which the task has its own."""
        if self.is_native:
            return None if self.columns is None else len(self.columns)
        return self.width if self.joints else ACTION_DIM

    @property
    def _arms(self) -> int:
        """Arms, by option or convention."""
        return int(PRESETS.get(self.convention, {}).get("arms", self.arms))

    @property
    def width(self) -> int:
        """Number of columns that are read of an answer's row."""
        if self.has_joints:
            return self._arms * (int(self.joints or PRESETS[self.convention]["joints"]) + 1)
        return ACTION_DIM + 1 if self.turns_by_quaternion else ACTION_DIM


class ServerOptions(Convention):
    """The options of a policy behind a server: those of the kind `openpi`."""

    PROTOCOL: ClassVar[str] = WireProtocol.OPENPI.value
    """The kind, with which its addresses begin."""
    FORM: ClassVar[str] = "openpi://HOST:PORT"
    """The form of an address."""
    SCHEMES: ClassVar[Mapping[str, str]] = {"ws": "ws", "wss": "wss"}
    """Scheme of an address to that under which it is kept; an address without one has the first."""
    PATH: ClassVar[str | None] = ""
    """The path of an address without one; None if no address has one."""
    EXTRA: ClassVar[str] = ""
    """The extra of RoboGauntlet that installs what it needs, or ""."""
    ASKS_UNITS: ClassVar[bool] = False
    """Whether units are asked for that neither the server nor an option says, see `unsaid`."""
    TRANSPORT: ClassVar[tuple[str, ...]] = (
        *("connect_timeout_s", "timeout_s", "retries"),
        *("token_variable", "token_scheme"),
    )
    """Options that do not decide how the policy acts."""
    UNUSED: ClassVar[frozenset[str]] = frozenset()
    """Options of other protocols that have no meaning in this one."""

    address: str
    """ws://HOST:PORT, wss://HOST, or openpi://HOST:PORT, with a path if it has one; HOST:PORT alone means ws"""
    identity: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """the policy's checkpoint name or hash; by default the metadata that the server sends on connection, or its address
    if it sends none"""
    expected_metadata: str | None = None
    """hash of the metadata that the server must send, of a policy with an identity; set when a run is planned"""
    connect_timeout_s: Seconds = 10.0
    """seconds to wait for a connection"""
    timeout_s: Seconds = 60.0
    """seconds to wait for an answer, reconnections included"""
    retries: Annotated[int, Field(strict=True, ge=0, le=1000)] = 3
    """times that a lost connection is opened again for one query"""
    token_variable: str | None = None
    """ROBOGAUNTLET_POLICY_TOKEN or ROBOGAUNTLET_POLICY_TOKEN_NAME: environment variable with the server's token"""
    token_scheme: Literal["Bearer", "Api-Key"] = "Bearer"
    """Bearer or Api-Key"""

    @field_validator("address")
    @classmethod
    def _whole(cls, value: str) -> str:
        first = next(iter(cls.SCHEMES))
        scheme, separator, rest = value.partition("://")
        if not separator:
            scheme, rest = first, value
        scheme = cls.SCHEMES.get(first if scheme == cls.PROTOCOL else scheme, "")
        try:
            parts = urlsplit(f"{scheme}://{rest}")
            sound = scheme != "" and bool(parts.hostname) and parts.port != 0 and parts.username is None
            sound = sound and (parts.path + parts.query).isascii()
            sound = sound and (cls.PATH is not None or (parts.port is not None and parts.path + parts.query == ""))
        except ValueError:
            sound = False
        if not sound or any(character.isspace() for character in value):
            shown = "one with a user or password" if "@" in value else f"'{value}'"
            raise ValueError(f"expected {cls.FORM}, got {shown}")
        return f"{scheme}://{rest}" + ("" if parts.path or cls.PATH is None else cls.PATH)

    @field_validator("token_variable")
    @classmethod
    def _a_policy_s(cls, value: str | None) -> str | None:
        if value is not None and not _TOKEN_VARIABLE.fullmatch(value):
            expected = f"expected {POLICY_TOKEN} or {POLICY_TOKEN}_NAME"
            raise ValueError(f"{expected}, since a suite names no other secret; got '{value[:200]}'")
        return value

    @model_validator(mode="after")
    def _kept_secret(self) -> Self:
        address = urlsplit(self.address)
        safe = address.scheme in ENCRYPTED or is_loopback(address.hostname or "")
        if self.token_variable is not None and not safe:
            over = "".join(f"over {scheme}:// or " for scheme in ENCRYPTED if scheme in self.SCHEMES.values())
            raise ValueError(f"token_variable: a token is sent {over}to this machine only, got {self.address}")
        return self

    @property
    def is_plain(self) -> bool:
        """Whether no option of the convention is given, so that RoboGauntlet's own server needs no conversion."""
        return not self.model_fields_set - {*_WHO, *self.TRANSPORT}

    def declaration(self) -> dict[str, Any]:
        """Return the options that decide how the policy acts, all but its address and time limits, as plain values."""
        options = self.model_dump(mode="json", exclude={*_WHO, *self.TRANSPORT})
        return {name: value for name, value in options.items() if (name, value) not in _ADDED_DEFAULTS}

    def digest(self, who: object) -> str:
        """Return the hash of the policy's content; `who`, plain values, identifies the policy behind the address."""
        return content_hash({"policy": self.PROTOCOL, "card": self.declaration(), "who": who})


_WHO = {"address", "identity", "expected_metadata"}
_ADDED_DEFAULTS = (
    *(("convention", "robogauntlet"), ("turn", "none"), ("rotation", "axis-angle")),
    *(("joints", None), ("joint_scale", 1.0), ("velocity_scale", None), ("arms", 1)),
)
"""Defaults of options that were added later: left out of the digest, so that older digests stay the same."""
CONVENTION_OPTIONS = {name: field.description or "" for name, field in Convention.model_fields.items()}


def options_of(kind: type[ServerOptions]) -> dict[str, str]:
    """Return option to meaning."""
    fields = kind.model_fields.items()
    left_out = {"expected_metadata", *kind.UNUSED}
    return {name: field.description or "" for name, field in fields if name not in left_out}


def read_options(options: Mapping[str, Any], kind: type[ServerOptions] = ServerOptions) -> ServerOptions:
    """Read a suite's options. Raises PolicyError if one is missing or invalid."""
    try:
        return kind.model_validate(dict(options)).resolved()
    except ValidationError as error:
        raise PolicyError(f"policy '{kind.PROTOCOL}': {first_fault(error)}") from None
