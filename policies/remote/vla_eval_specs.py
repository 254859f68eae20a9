"""What the specs of a model server of vla-evaluation-harness (`vla_eval.specs`) say, in our options.

A spec names the format of each part of an action and an observation. It has no units: its own servers of LIBERO declare
rotations in radians and send shares of the controller's largest offset. So the scales are the user's to say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from robogauntlet.adapters.contract import Moves
from robogauntlet.policies.contract import PolicyMismatch
from robogauntlet.policies.remote.server_options import ServerOptions
from robogauntlet.policies.stored import first_fault
from robogauntlet.support.text import visible

PARTS: Mapping[str, Mapping[str, tuple[int, Mapping[str, Any]]]] = {
    "position": {"delta_xyz": (3, {})},
    "rotation": {
        "axis_angle": (3, {"rotation": "axis-angle"}),
        "euler_xyz": (3, {"rotation": "euler"}),
        "quaternion_xyzw": (4, {"rotation": "quaternion-xyzw"}),
    },
    "gripper": {
        "binary_close_positive": (1, {"gripper_open": -1.0, "gripper_closed": 1.0, "gripper_threshold": 0.0}),
        "binary_close_negative": (1, {"gripper_open": 1.0, "gripper_closed": -1.0, "gripper_threshold": 0.0}),
        "binary_close_01": (1, {"gripper_open": 0.0, "gripper_closed": 1.0, "gripper_threshold": 0.5}),
        "continuous_01": (1, {}),
    },
}
"""Part of an action, in their order, to the formats that can be converted, with their numbers and the options that they
say."""
BY_USER = {"rotation": {"rotation"}, "gripper": {"gripper_open", "gripper_closed"}}
"""Part to the options with which the user says what it means, in place of its format."""
STATE, JOINTS = "eef_pos3_axisangle3_gripper2", "joint_positions"
RAW, PICTURE, WORDS = "raw", "rgb_hwc_uint8", "language"
OF_JOINTS = {Moves.TARGETS: ("joint_positions", "joint_pos_abs"), Moves.VELOCITIES: (RAW,)}
"""What joints' numbers are to their formats; the harness has none for velocities."""


class _Part(BaseModel):
    """A part of an action or an observation."""

    dims: Annotated[int, Field(strict=True, ge=0, le=10_000)]
    format: Annotated[str, Field(strict=True, max_length=100)]

    def __str__(self) -> str:
        return visible(f"{self.format} of {self.dims} numbers")


_SPEC = TypeAdapter(Annotated[dict[Annotated[str, Field(max_length=100)], _Part], Field(max_length=64)])
_PARAMS = TypeAdapter(Annotated[dict[str, Any], Field(max_length=1000)])


def fitted(options: ServerOptions, said: Mapping[str, Any]) -> ServerOptions:
    """Return the options with what a server's HELLO says. The user's own are kept, and `convention` answers for all.

    Raises:
        PolicyMismatch: Something cannot be converted, or is said by neither; the message names the option.
    """
    action = _read(_SPEC, said, "action_spec")
    if options.joints:
        _check_joints(options, action)
    elif not options.is_native:
        options = _of_tool(options, action)
    params, observation = _read(_PARAMS, said, "observation_params"), _read(_SPEC, said, "observation_spec")
    if params.get("absolute_action") and not options.is_native:
        raise PolicyMismatch("expected displacements, its observation_params ask for absolute_action")
    return _observed(options, observation, params)


def _read(reader: TypeAdapter[Any], said: Mapping[str, Any], key: str) -> dict[str, Any]:
    try:
        found: dict[str, Any] = reader.validate_python(said.get(key) or {})
    except ValidationError as error:
        raise PolicyMismatch(f"expected {key} of parts with dims and format: {first_fault(error)}") from None
    return found


def _of_tool(options: ServerOptions, action: Mapping[str, _Part]) -> ServerOptions:
    given = options.model_fields_set
    names = [name for name, part in action.items() if name in PARTS or part.format != RAW]
    if options.columns is None and names != [name for name in PARTS if name in names]:
        remedy = "joints" if "joints" in names else "columns"
        got = visible(", ".join(names))
        raise PolicyMismatch(f"expected an action_spec of {', '.join(PARTS)}, got {got}; give option {remedy}")
    stated: dict[str, Any] = {}
    for name, formats in PARTS.items():
        part = action.get(name)
        if part is None or part.format == RAW or given & BY_USER.get(name, set()):
            continue
        numbers, says = formats.get(part.format, (0, {}))
        if part.dims != numbers:
            wanted = " or ".join(f"{known} of {count} numbers" for known, (count, _) in formats.items())
            raise PolicyMismatch(f"expected {name} as {wanted}, got {part}, which cannot be converted")
        stated |= says
    found = options.model_copy(update={name: value for name, value in stated.items() if name not in given})
    if missing := found.unsaid():
        raise PolicyMismatch(
            f"its action_spec does not say {', '.join(missing)}; give each by an option, or all by option convention"
        )
    if found.columns is not None and len(found.columns) != found.width:
        raise PolicyMismatch(f"option columns: expected {found.width} places for a {found.rotation}")
    return found


def _check_joints(options: ServerOptions, action: Mapping[str, _Part]) -> None:
    for name, part in action.items():
        of_gripper = name == "gripper" or part.format == RAW
        formats = OF_JOINTS[options.moves]
        if not of_gripper and (part.format not in formats or part.dims not in (options.joints, options.width)):
            wanted = f"{' or '.join(formats)} of {options.joints} numbers"
            raise PolicyMismatch(f"expected {wanted}, as option joints says, got {visible(name)}: {part}")


def _observed(options: ServerOptions, spec: Mapping[str, _Part], params: Mapping[str, Any]) -> ServerOptions:
    given = options.model_fields_set
    found: dict[str, Any] = {}
    pictures = [name for name, part in spec.items() if part.format == PICTURE]
    known = (PICTURE, WORDS, RAW)
    for name, part in spec.items():
        if name != "state" and part.format not in known:
            raise PolicyMismatch(f"its observation_spec needs {visible(name)}: {part}, which no task shows")
    if "cameras" not in given:
        if len(pictures) > len(options.cameras):
            raise PolicyMismatch(
                f"its observation_spec needs {len(pictures)} images; name those that are sent by option cameras"
            )
        if len(pictures) < 2 and not params.get("send_wrist_image"):
            found["cameras"] = dict([next(iter(options.cameras.items()))])
    if "proprioception" not in given:
        state = spec.get("state")
        if state is None and not params.get("send_state"):
            found["proprioception"] = None
        elif (state is None or state.format == RAW) and "convention" not in given:
            raise PolicyMismatch(
                "its observation_spec does not say what its state is; give option proprioception: state, or null"
            )
        elif state is not None and state.format not in (RAW, JOINTS if options.joints else STATE):
            raise PolicyMismatch(
                f"its observation_spec needs state: {state}, which cannot be converted; "
                "give option proprioception: null to leave it out"
            )
    return options.model_copy(update=found)
