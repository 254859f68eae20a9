"""What a server of vla-evaluation-harness' protocol says of a policy, and how it reads observations.

A benchmark of LIBERO gets and sends what LIBERO's own does: shares of the controller's largest offset, mirrored images,
poses in the world. All others are taken to have the units of `robogauntlet.adapters.contract`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ACTION_DIM, PROPRIOCEPTION_DIM, FloatArray, Moves
from robogauntlet.policies.contract import PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote import libero
from robogauntlet.policies.remote.conversion import resize_image, turn_image
from robogauntlet.policies.remote.msgpack_numpy import PackingError
from robogauntlet.policies.remote.protocol import Keys, query_in
from robogauntlet.policies.remote.server_options import (
    VLA_EVAL_CAMERAS,
    VLA_EVAL_INSTRUCTION,
    VLA_EVAL_STATE,
    Convention,
)
from robogauntlet.policies.remote.vla_eval_messages import received
from robogauntlet.policies.remote.vla_eval_specs import JOINTS, PICTURE, STATE, WORDS
from robogauntlet.suites.episode import Episode

KEYS = Keys(VLA_EVAL_CAMERAS, VLA_EVAL_STATE, VLA_EVAL_INSTRUCTION)
STATES = "states"
"""LIBERO's key of `KEYS.state`."""
OWN, LIBERO = Convention(), Convention(convention="libero").resolved()
THEIRS = "vla_eval.benchmarks."
"""Beginning of the names of the benchmarks that come with the harness."""


def specs_of(spec: PolicySpec, numbers: int) -> dict[str, Any]:
    """Return what a policy, with this many numbers of an action, gives and takes, as a HELLO says it.

    Raises:
        PolicyMismatch: The protocol has no words for it.
    """
    if spec.sees is PolicyInput.PRIVILEGED_STATE:
        raise PolicyMismatch("expected a policy that sees observations, got one that acts on the true state")
    if spec.moves in (Moves.VELOCITIES, Moves.NATIVE):
        raise PolicyMismatch(f"expected a policy of tools or targets of joints, got one of {spec.moves}")
    if numbers == 2 * ACTION_DIM:
        raise PolicyMismatch("expected a policy of one arm, got one of two, for which the protocol has no specs")
    of_tool = numbers == ACTION_DIM and spec.moves is not Moves.TARGETS
    moved = (
        [("position", 3, "delta_xyz"), ("rotation", 3, "axis_angle")] if of_tool else [("joints", numbers - 1, JOINTS)]
    )
    said = {"action_spec": _parts(*moved, ("gripper", 1, "binary_close_positive"))}
    if spec.sees is PolicyInput.NOTHING:
        return said
    cameras = [key for camera, key in KEYS.cameras.items() if camera in (spec.cameras or KEYS.cameras)]
    state = (KEYS.state, PROPRIOCEPTION_DIM, STATE) if of_tool else (KEYS.state, numbers, JOINTS)
    shown = _parts(*((key, 0, PICTURE) for key in cameras), state, ("language", 0, WORDS))
    params = {"send_wrist_image": KEYS.cameras["wrist"] in cameras, "send_state": True}
    return said | {"observation_spec": shown, "observation_params": params}


def _parts(*parts: tuple[str, int, str]) -> dict[str, Any]:
    return {name: {"name": name, "dims": dims, "format": form} for name, dims, form in parts}


def task_and_convention(task: Mapping[str, Any], benchmark: str) -> tuple[str | None, Convention]:
    """Return the task (`simulator/task`) that an episode's start names, None if it names none, and its units.

    Args:
        task: The task of the message.
        benchmark: The benchmark's name in the HELLO, or "".

    Raises:
        PackingError: It is of a benchmark of the harness that has other units.
    """
    suite, number = task.get("suite"), task.get("task_id")
    known = libero.task_of(str(suite)[:100], number if type(number) is int else "", task.get("name"))
    if known is not None:
        return known, LIBERO
    if benchmark.startswith(THEIRS):
        raise PackingError(f"expected a suite of LIBERO or a benchmark in RoboGauntlet's units, got {str(suite)[:100]}")
    return None, OWN


def query_of(
    payload: Mapping[str, Any], episode: Episode, step: int, spec: PolicySpec, convention: Convention
) -> Query:
    """Return an OBSERVATION as a policy's query, with images of the size that it needs.

    Raises:
        PackingError: An input of the policy is missing or malformed.
        PolicyMismatch: It is of a task of LIBERO whose scene is not known.
    """
    if spec.sees is PolicyInput.NOTHING:
        return Query(episode, step)
    given = payload.get("images")
    images = {str(key): received(image) for key, image in given.items()} if isinstance(given, dict) else {}
    state = {KEYS.state: received(payload.get(KEYS.state, payload.get(STATES)))}
    words = {key: payload[key] for key in (KEYS.instruction,) if key in payload}
    query = query_in(images | state | words, episode, step, replace(spec, image_size=None), KEYS)
    seen = query.observation
    assert seen is not None  # `specs_of` refuses the true state
    sized = convention.model_copy(update={"image_size": spec.image_size})
    shown = {name: resize_image(sized, turn_image(sized, name, image)) for name, image in seen.images.items()}
    known = seen.proprioception
    if convention is LIBERO:
        known = libero.own_proprioception(episode.task, known)
    return replace(query, observation=replace(seen, images=shown, proprioception=known))


def native_action(convention: Convention, action: FloatArray) -> FloatArray:
    """Return an action (numbers of an action,) in the benchmark's units."""
    if len(action) != ACTION_DIM:
        return action
    return action / np.array([convention.translation_scale] * 3 + [convention.rotation_scale] * 3 + [1.0])
