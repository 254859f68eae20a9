"""Frames of the policy protocol: whatever a server or a client sends, it is read or refused in one line."""

from dataclasses import replace

import msgpack
import numpy as np
from hypothesis import example, strategies as st

from robogauntlet.policies.contract import PolicyMismatch
from robogauntlet.policies.remote.conversion import decode_chunk
from robogauntlet.policies.remote.gr00t import Gr00tOptions
from robogauntlet.policies.remote.gr00t_modalities import fitted as gr00t_fitted, modalities_in
from robogauntlet.policies.remote.gr00t_wire import read_message
from robogauntlet.policies.remote.msgpack_numpy import PackingError, nd_message, pack, unpack
from robogauntlet.policies.remote.openpi_config import check_options, config_in
from robogauntlet.policies.remote.openvla import as_rows
from robogauntlet.policies.remote.protocol import (
    as_message,
    as_metadata,
    episode_in,
    finished_in,
    greeting_in,
    greeting_of,
    query_in,
    routing_in,
)
from robogauntlet.policies.remote.server_options import Convention, ServerOptions
from robogauntlet.policies.remote.vla_eval import VlaEvalOptions
from robogauntlet.policies.remote.vla_eval_messages import Kind, message_of
from robogauntlet.policies.remote.vla_eval_server import query_of, task_and_convention
from robogauntlet.policies.remote.vla_eval_specs import fitted
from robogauntlet.policies.remote.xpolicylab import chunks_in
from tests.fuzz.damage import damaged_bytes, damaged_value, fuzzed, in_one_line
from tests.fuzz.example_messages import ANSWER, POLICY, QUERY
from tests.policies.remote.gr00t_server import LIBERO, N16, N17
from tests.policies.remote.vllm_omni_server import CONFIG

HELLO = {
    "action_spec": {"position": {"dims": 3, "format": "delta_xyz"}, "gripper": {"dims": 1, "format": "raw"}},
    "observation_spec": {"image": {"dims": 0, "format": "rgb_hwc_uint8"}, "state": {"dims": 0, "format": "raw"}},
    "observation_params": {"send_wrist_image": True},
}
TASK = {"name": "reach the ball", "suite": "libero_goal", "task_id": 3, "episode_idx": 0}
_SEEN = QUERY.observation
SHOWN = {
    "images": dict(zip(("agentview", "wrist"), _SEEN.images.values(), strict=True)),
    "states": _SEEN.proprioception,
    "task_description": _SEEN.instruction,
}
EPISODE = message_of(Kind.OBSERVATION, {"task": TASK, "seen": SHOWN}, 1)["payload"]
CHUNK = {"x": np.zeros((1, 4, 1), np.float32)}
GR00T_FRAMES = [msgpack.packb([CHUNK, {}], default=writes.array) for writes in (N16, N17)]
GREETING = as_metadata(greeting_of(POLICY, "0123456789abcdef"))
MESSAGE = as_message(QUERY, ["an-episode"])
CONVENTIONS = (
    Convention(),
    Convention(columns=(0, 1, 2, 3, 4, 5, None), rotation="euler"),
    Convention(columns=(0, 1, 2, 3, 4, 5, 6, 6), rotation="quaternion-wxyz"),
)


@fuzzed(st.sampled_from([pack(GREETING), pack(MESSAGE), pack(ANSWER)]).flatmap(damaged_bytes))
@example(damaged=b"\x91" * 10_000)
@example(damaged=b"\xdd\xff\xff\xff\xff")
def test_a_damaged_frame(damaged):
    try:
        content = unpack(damaged)
    except PackingError as error:
        in_one_line(error)
        return
    if isinstance(content, dict):
        read_as_client(content)
        read_as_server(content)


@fuzzed(damaged_value(GREETING) | damaged_value(ANSWER))
@example(damaged={"a\nb": 1})
def test_a_damaged_message_of_a_server(damaged):
    read_as_client(damaged)


@fuzzed(damaged_value(MESSAGE))
@example(damaged={**{name: MESSAGE[name] for name in MESSAGE if "image" not in name}, "a\nb": 1})
@example(damaged=MESSAGE | {"robogauntlet/step": "a\nb"})
def test_a_damaged_message_of_a_client(damaged):
    read_as_server(damaged)


@fuzzed(damaged_value(HELLO))
def test_damaged_specs_of_a_model_server(damaged):
    options = VlaEvalOptions(address="a:1", convention="robogauntlet")
    refusable(lambda: fitted(options, damaged if isinstance(damaged, dict) else {}))


@fuzzed(damaged_value(EPISODE))
@example(damaged=EPISODE | {"task": {"suite": "a\nb", "task_id": "\ud800"}})
def test_a_damaged_episode_of_a_benchmark(damaged):
    task, seen = (damaged.get(part) if isinstance(damaged, dict) else None for part in ("task", "seen"))

    def read():
        name, convention = task_and_convention(task if isinstance(task, dict) else {}, "vla_eval.benchmarks.x")
        episode = replace(QUERY.episode, task=name)
        query_of(seen if isinstance(seen, dict) else {}, episode, 0, POLICY.spec, convention)

    refusable(read)


@fuzzed(damaged_value([[{"__numpy__": "AAAAAAAA8D8=", "dtype": "<f8", "shape": [1]}, 0.0]]))
@example(damaged={"__numpy__": "AAAA", "dtype": "<f8", "shape": [10**9]})
def test_a_damaged_answer_of_an_openvla_server(damaged):
    refusable(lambda: decode_chunk(Convention(), as_rows(damaged, "actions")))


@fuzzed(damaged_value(CONFIG | {"action_space": "delta"}))
def test_a_damaged_configuration_of_vllm_omni(damaged):
    def read():
        config = config_in(damaged if isinstance(damaged, dict) else {})
        if config is not None:
            check_options(config, ServerOptions(address="a:1", image_size=32))

    refusable(read)


@fuzzed(damaged_value([{"arm": nd_message(np.zeros(7)), "hand": 0.5}] * 2))
@example(damaged=[{"arm": [[0.0], [0.0, 1.0]], "hand": {b"nd": True, b"type": "<f8", b"shape": [10**9]}}])
def test_damaged_actions_of_an_xpolicylab_server(damaged):
    refusable(lambda: decode_chunk(Convention(), {"actions": chunks_in(damaged, ("arm", "hand"))["arm"]}))


@fuzzed(st.sampled_from(GR00T_FRAMES).flatmap(damaged_bytes))
def test_a_damaged_frame_of_a_gr00t_server(damaged):
    refusable(lambda: read_message(damaged))


@fuzzed(damaged_value({name: {"__ModalityConfig__": True, "as_json": config} for name, config in LIBERO.items()}))
def test_damaged_modalities_of_a_gr00t_server(damaged):
    options = Gr00tOptions(address="a:1", convention="libero")
    refusable(lambda: gr00t_fitted(options, modalities_in(damaged)))


def read_as_client(content):
    refusable(lambda: greeting_in(content))
    refusable(lambda: routing_in(content))
    for convention in CONVENTIONS:
        refusable(lambda convention=convention: np.testing.assert_equal(decode_chunk(convention, content).shape[1], 7))


def read_as_server(content):
    def read():
        found = episode_in(content)
        assert all(isinstance(name, str) for name in finished_in(content))
        if found is not None:
            query_in(content, *found, POLICY.spec)

    refusable(read)


def refusable(read):
    """Read something, which may be refused in one line."""
    try:
        read()
    except (PackingError, PolicyMismatch) as error:
        in_one_line(error)
