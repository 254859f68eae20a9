"""What the modalities of a GR00T policy (`gr00t.data.types.ModalityConfig`) say, in our options.

They name the keys of images, proprioception, instruction and actions, and the steps of each (`delta_indices`). They say
neither how many numbers a key has nor their units, which are the user's to say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from robogauntlet.policies.contract import PolicyMismatch
from robogauntlet.policies.remote.gr00t_wire import CONFIGS
from robogauntlet.policies.remote.server_options import Key, ServerOptions
from robogauntlet.policies.stored import first_fault
from robogauntlet.support.text import first_of, visible

VIDEO, STATE, LANGUAGE, ACTION = "video", "state", "language", "action"
LIBEROS = {"x": (0,), "y": (1,), "z": (2,), "roll": (3,), "pitch": (4,), "yaw": (5,), "gripper": (6, 7)}
"""Key to columns of the proprioception of policies trained on LIBERO's data; roll, pitch and yaw are an axis-angle."""
Keys = Annotated[tuple[Key, ...], Field(max_length=64)]


class _Action(BaseModel):
    """What one key of an action means, where a server says it."""

    model_config = ConfigDict(extra="ignore")

    type: str = ""


class Modality(BaseModel):
    """The keys of a modality and its steps, of which 0 is the present one."""

    model_config = ConfigDict(extra="ignore")

    delta_indices: Annotated[tuple[int, ...], Field(max_length=1000)]
    modality_keys: Keys
    action_configs: Annotated[tuple[_Action, ...], Field(max_length=64)] | None = None


_MODALITIES = TypeAdapter(dict[str, Modality])


def modalities_in(message: Any) -> dict[str, Modality]:
    """Return a server's modalities by name. Raises PolicyMismatch for another message, or of N1.5."""
    configs = message if isinstance(message, Mapping) else {}
    found = {
        name: config["as_json"]
        for name, config in configs.items()
        if isinstance(config, Mapping) and any(marker in config for marker in CONFIGS) and "as_json" in config
    }
    try:
        modalities = _MODALITIES.validate_python(found)
    except ValidationError as error:
        raise PolicyMismatch(
            f"expected modalities with modality_keys and delta_indices: {first_fault(error)}"
        ) from None
    if missing := [name for name in (VIDEO, LANGUAGE, ACTION) if name not in modalities]:
        got = visible(", ".join(map(str, configs))[:100]) or "none"
        raise PolicyMismatch(f"expected modalities {VIDEO}, {LANGUAGE} and {ACTION}, got {got}: no {missing[0]}")
    for name, modality in modalities.items():
        if prefixed := [key for key in modality.modality_keys if key.startswith(f"{name}.")]:
            shown = visible(prefixed[0])
            raise PolicyMismatch(f"expected keys as of GR00T N1.6, got {shown}, as of N1.5; serve the policy by N1.6")
        if name in (VIDEO, STATE, LANGUAGE) and modality.delta_indices != (0,):
            steps = ", ".join(map(str, modality.delta_indices[:10])) or "none"
            raise PolicyMismatch(f"expected {name} of the present step alone, delta_indices 0, got {steps}")
    return modalities


def fitted(options: ServerOptions, modalities: Mapping[str, Modality]) -> ServerOptions:
    """Return the options with what a server's modalities say. The user's own are kept.

    Raises:
        PolicyMismatch: A key is not filled, or not asked for, or units are not said; the message names the option.
    """
    if missing := options.unsaid():
        raise PolicyMismatch(
            f"its modalities do not say {', '.join(missing)}; give each by an option, or all by option convention"
        )
    keys = {name: modality.modality_keys for name, modality in modalities.items()}
    (instruction, *more), given = keys[LANGUAGE] or ("",), options.model_fields_set
    if more or (options.instruction or instruction) != instruction:
        raise _unfilled(LANGUAGE, keys[LANGUAGE], [options.instruction or "one key"], "instruction")
    cameras = options.cameras
    if "cameras" not in given:
        cameras = {camera: key for camera, key in cameras.items() if key in keys[VIDEO]}
    if set(cameras.values()) != set(keys[VIDEO]):
        raise _unfilled(VIDEO, keys[VIDEO], [*cameras.values()], "cameras: {third_person: KEY}")
    state = options.proprioception
    if "proprioception" not in given and options.convention == "libero":
        state = LIBEROS
    filled = [state] if isinstance(state, str) else [*(state or ())]
    if set(filled) != set(keys.get(STATE, ())):
        raise _unfilled(STATE, keys.get(STATE, ()), filled, "proprioception: {KEY: [columns]}")
    actions = keys[ACTION] if "actions" not in given else options.actions
    if beyond := {*([actions] if isinstance(actions, str) else actions)} - {*keys[ACTION]}:
        raise _unfilled(ACTION, keys[ACTION], [*beyond], "actions: [KEY, ...]")
    _check_motion(modalities[ACTION])
    update = {"cameras": cameras, "proprioception": state, "instruction": instruction, "actions": actions}
    return options.model_copy(update=update)


def _check_motion(action: Modality) -> None:
    for key, config in zip(action.modality_keys, action.action_configs or (), strict=False):
        if config.type == "EEF":
            raise PolicyMismatch(
                f"expected displacements of the tool or targets of joints, its action {visible(key)} is a pose"
            )


def _unfilled(modality: str, needs: Sequence[str], filled: Sequence[str], option: str) -> PolicyMismatch:
    missing = [key for key in needs if key not in filled and modality != ACTION]
    fault = f"nothing fills {first_of(missing, 10)}" if missing else "it has no such key"
    return PolicyMismatch(
        visible(f"its {modality} is {first_of([*needs], 10) or 'nothing'}, got {first_of(filled, 10) or 'nothing'}: ")
        + visible(f"{fault}; give option {option}")
    )
