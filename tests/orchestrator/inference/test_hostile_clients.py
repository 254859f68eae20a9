"""Clients that mean harm get one line each; the server's memory stays bounded and other clients are served."""

import resource
from contextlib import ExitStack

import msgpack
import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from robogauntlet.orchestrator.inference import websocket_server
from robogauntlet.policies import catalog
from robogauntlet.policies.remote.msgpack_numpy import pack, unpack
from robogauntlet.policies.remote.server_options import CAMERA_KEYS, INSTRUCTION_KEY, STATE_KEY
from tests.policies.remote.test_client import QUICK, query
from tests.remote_servers import serving

MESSAGES = {
    "too many keys": (msgpack.packb({str(n): 0 for n in range(100_001)}), "expected a message of 100000 values"),
    "lists announced": (b"\x81\xa1a" + b"\xdd\x00\xff\xff\xff" * 100_000, "expected a message of 100000 values"),
    "nested": (b"\x81\xa1a" * 500 + b"\xc0", "expected 32 levels of lists and mappings"),
    "an image of 10^9 pixels": (
        msgpack.packb(
            {
                "observation/image": {
                    b"__ndarray__": True,
                    b"data": b"\0",
                    b"dtype": "|u1",
                    b"shape": [40_000, 25_000, 3],
                }
            }
        ),
        "expected an array of type uint8 and shape",
    ),
    "a hundred thousand words": (
        pack(
            {key: np.zeros((96, 96, 3), np.uint8) for key in CAMERA_KEYS.values()}
            | {STATE_KEY: np.zeros(8), INSTRUCTION_KEY: "a " * 100_000}
        ),
        "expected at most 1000 characters as prompt, got 200000",
    ),
    "five million finished": (msgpack.packb({"robogauntlet/finished": ["a"] * 5_000_000}), "100000 values"),
}


@pytest.mark.parametrize(("message", "line"), MESSAGES.values(), ids=MESSAGES)
def test_a_hostile_message_is_answered_in_one_line(message, line):
    with serving("untrained") as server, connect(server.address, compression=None, max_size=None) as client:
        client.recv()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        client.send(message)
        answer = client.recv(timeout=20)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 * 1024  # KiB
        assert answer.startswith("expected ")
        assert line in answer
        assert "\n" not in answer
        policy = catalog.load("openpi", {"address": server.address, **QUICK})
        assert policy.act([query()])[0].actions.shape == (8, 7)
        policy.close()


def test_one_client_too_many_is_refused_until_another_leaves(monkeypatch):
    monkeypatch.setattr(websocket_server, "MAX_CLIENTS", 3)
    with serving("untrained") as server:
        with ExitStack() as stack:
            for _ in range(3):
                assert "cameras" in unpack(stack.enter_context(connect(server.address)).recv())
            with pytest.raises(InvalidStatus, match="503"), connect(server.address):
                pass
        policy = catalog.load("openpi", {"address": server.address, **QUICK, "retries": 10, "connect_timeout_s": 20.0})
        assert policy.act([query()])[0].actions.shape == (8, 7)
        policy.close()
