"""What a server of openpi's protocol asks of its clients, in a `policy_server_config` as vLLM-Omni's.

The contract is that of https://github.com/vllm-project/vllm-omni (Apache 2.0), `docs/serving/openpi_api.md`: the
configuration is the server's metadata. An observation is for the `endpoint` "infer" and belongs to a session, which
ends when another one begins on the connection; `seed` is that of the model's noise. The answer is an array or a mapping
of arrays, and may have an axis for the batch; an error is a mapping.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any
from urllib.parse import urlsplit

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robogauntlet.adapters.contract import Moves
from robogauntlet.policies.contract import PolicyError, PolicyMismatch, Query
from robogauntlet.policies.remote.connection import error_text
from robogauntlet.policies.remote.server_options import ServerOptions
from robogauntlet.policies.stored import first_fault
from robogauntlet.suites.episode import CAMERAS, content_hash
from robogauntlet.support.text import visible

PATH = "/v1/realtime/robot/openpi"
"""The path of vLLM-Omni's endpoint, which takes a seed."""
UNAVAILABLE = "Robot policy not available"
SAYS = "as its policy_server_config says"
OF_JOINTS = {"joint_position": Moves.TARGETS, "joint_velocity": Moves.VELOCITIES}
NOT_PLAYED = ("cartesian_position", "cartesian_velocity")
"""Action spaces that are neither motions of the tool nor of joints."""


class PolicyServerConfig(BaseModel):
    """What a model needs and gives. Models leave out fields and have others."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    needs_session_id: bool
    image_resolution: tuple[int, int] | None = None
    """Height and width, px."""
    n_external_cameras: int | None = None
    needs_wrist_camera: bool = False
    needs_stereo_camera: bool = False
    action_space: Annotated[str, Field(max_length=100)] = ""


def config_in(metadata: Mapping[str, Any]) -> PolicyServerConfig | None:
    """Return the configuration in a server's metadata, None for other metadata. PolicyMismatch if it is malformed."""
    if "needs_session_id" not in metadata:
        return None
    try:
        return PolicyServerConfig.model_validate(dict(metadata))
    except ValidationError as error:
        raise PolicyMismatch(f"expected a policy_server_config as metadata: {first_fault(error)}") from None


def check_options(config: PolicyServerConfig, options: ServerOptions) -> None:
    """Compare what a server asks for with what is sent. Raises PolicyMismatch; the message names the option."""
    size, resolution = options.image_size, config.image_resolution
    if resolution is not None and resolution != (size if isinstance(size, tuple) else (size, size)):
        given = list(size) if isinstance(size, tuple) else size
        raise PolicyMismatch(f"expected option image_size: {list(resolution)}, {SAYS}, got {given or 'none'}")
    third_person, wrist = (camera in options.cameras for camera in CAMERAS)
    external = config.n_external_cameras
    if external not in (None, 0, int(third_person)):
        got = "tasks show one" if third_person else "none; give third_person by option cameras"
        raise PolicyMismatch(f"expected {external} external cameras, {SAYS}, got {got}")
    if config.needs_wrist_camera and not wrist:
        raise PolicyMismatch(f"expected a wrist camera, {SAYS}, got none; give wrist by option cameras")
    if config.needs_stereo_camera:
        raise PolicyMismatch(f"expected stereo cameras, {SAYS}, got a camera, which is what tasks show")
    _check_motion(config.action_space, options.moves)


def _check_motion(space: str, moves: Moves) -> None:
    if space in NOT_PLAYED or (space and OF_JOINTS.get(space, Moves.TOOL) is not moves):
        wanted = moves if moves is Moves.TOOL else f"{moves}, as options say"
        hint = "; give options joints and, for velocities, velocity_scale" if space in OF_JOINTS else ""
        raise PolicyMismatch(f"expected {wanted}, got the action_space {visible(space)}{hint}")


def request_part(config: PolicyServerConfig, options: ServerOptions, query: Query, session: str) -> dict[str, Any]:
    """Return what an observation has beside its own keys."""
    part: dict[str, Any] = {"endpoint": "infer"}
    if config.needs_session_id:
        part["session_id"] = session
    if urlsplit(options.address).path.rstrip("/") == PATH:
        part["seed"] = int(content_hash([query.episode.id, query.step]), 16) % 2**32
    return part


def one_of_batch(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return an answer without the axis of a batch of one. Raises PolicyError for the server's error."""
    if answer.get("type") == "error":
        raise PolicyError(
            f"expected an answer, got an error: {error_text(answer.get('message'))}; see the server's log, and whether "
            "options cameras, proprioception and instruction name what its model expects"
        )
    return {
        key: value[0] if isinstance(value, np.ndarray) and value.ndim == 3 and len(value) == 1 else value
        for key, value in answer.items()
    }


def explained(text: object) -> str:
    """Return the error in a text frame; that of a model that is no robot policy says what to do."""
    if UNAVAILABLE in str(text):
        return f"{UNAVAILABLE}: its model has no policy_server_config; serve a robot policy"
    return error_text(text)
