"""A server in the manner of vLLM-Omni's OpenPI endpoint, written from its contract, in a thread."""

import contextlib
import json

import numpy as np

from robogauntlet.policies.remote.msgpack_numpy import pack, unpack
from tests.remote_servers import speaking

PATH = "/v1/realtime/robot/openpi"
CONFIG = {
    "image_resolution": [32, 32],
    "n_external_cameras": 1,
    "needs_wrist_camera": True,
    "needs_stereo_camera": False,
    "needs_session_id": True,
    "action_horizon": 8,
}


def actions(observation):
    """A chunk that moves forward as the seed says, as a model's noise would."""
    chunk = np.zeros((8, 7), np.float32)
    chunk[:, 0] = observation["seed"] % 100 / 1e4
    return chunk


@contextlib.contextmanager
def serving(config=CONFIG, infer=actions, seen=None, cut=lambda count: False):
    """A server of a model, of none with `config=None`; yields its address.

    `seen` gets (observation, reset) of each inference. The connection is cut in place of an answer when `cut(count)`.
    """
    count = 0

    def handle(connection):
        nonlocal count
        assert connection.request.path == PATH
        if config is None:
            error = {"type": "error", "error": "Robot policy not available", "code": "unsupported"}
            connection.send(json.dumps(error))
            return
        connection.send(pack(config))
        session, calls = None, 0
        for frame in connection:
            observation = unpack(frame)
            assert observation.pop("endpoint", "infer") == "infer"
            named = str(observation.get("session_id") or session or "default")
            session, calls = named, calls + 1 if named == session else 1
            count += 1
            if cut(count):
                return
            if seen is not None:
                seen.append((observation, calls == 1))
            try:
                answer = infer(observation)
            except Exception:
                answer = {"type": "error", "message": "Internal inference error"}
            connection.send(pack(answer))

    with speaking(handle) as address:
        yield address.replace("ws://", "openpi://") + PATH
