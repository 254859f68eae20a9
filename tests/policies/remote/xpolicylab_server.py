"""A policy server in the manner of XPolicyLab's, written from its contract, in a thread."""

import contextlib

import numpy as np

from robogauntlet.policies.remote.msgpack_numpy import nd_array, nd_message, pack, unpack
from tests.remote_servers import speaking


def targets(observation, step):
    """A chunk of targets of six joints that are 0.1 rad from where they are, and the first pixel as the gripper."""
    joints = observation["state"]["arm_joint_state"] + 0.1
    pixel = observation["vision"]["cam_head"]["color"][0, 0, 0] / 255
    return [{"arm_joint_state": joints, "ee_joint_state": np.array([pixel])}] * 4


def displacements(observation, step):
    """A chunk that moves forward by the number of queries of the trial, and turns by nothing."""
    pose = np.array([step / 100, 0, 0, 1, 0, 0, 0])
    return [{"delta_ee_pose": pose, "ee_joint_state": 1.0, "score": "0.9"}] * 4


def _received(value):
    if isinstance(value, dict):
        return {key: _received(item) for key, item in value.items()} if b"nd" not in value else nd_array(value)
    return value


def _sent(value):
    if isinstance(value, np.ndarray):
        return nd_message(value)
    if isinstance(value, dict):
        return {key: _sent(item) for key, item in value.items()}
    return [_sent(item) for item in value] if isinstance(value, list) else value


@contextlib.contextmanager
def serving(infer=targets, seen=None, cut=lambda kind, count: False):
    """A server; yields its address. `seen` gets (message type, trial, payload) of each question.

    The connection is cut in place of an answer when `cut(kind, count)`.
    """
    count = queries = 0

    def answer(kind, payload):
        nonlocal queries
        if kind == "hello":
            return "hello_ack", {"ok": True, "server": "xpolicylab_policy_server", "server_instance_id": "5e1f"}
        if kind == "reset":
            queries = 0
            return "reset_result", {"ok": True}
        if kind == "trial_end":
            return "trial_end_ack", {"ok": True}
        queries += 1
        try:
            return "infer_result", {"actions": _sent(infer(payload["observation"], queries)), "latency_ms": 1.5}
        except Exception as error:
            return "error", {"code": "infer_failed", "message": str(error), "details": {}}

    def handle(connection):
        nonlocal count
        for frame in connection:
            asked = unpack(frame)
            kind, payload = asked["message_type"], _received(asked["payload"])
            count += 1
            if cut(kind, count):
                return
            if seen is not None:
                seen.append((kind, asked["trial_id"], payload))
            found, said = answer(kind, payload)
            connection.send(pack(asked | {"message_type": found, "payload": said}))

    with speaking(handle) as address:
        yield address.replace("ws://", "xpolicylab://")
