"""A policy server in the manner of GR00T, written from its contract: msgpack over a ZeroMQ socket, in a thread."""

import contextlib
import io
import json
import threading

import msgpack
import numpy as np
import zmq

LIBERO = {
    "video": {"delta_indices": [0], "modality_keys": ["image", "wrist_image"]},
    "state": {"delta_indices": [0], "modality_keys": ["x", "y", "z", "roll", "pitch", "yaw", "gripper"]},
    "action": {"delta_indices": [*range(16)], "modality_keys": ["x", "y", "z", "roll", "pitch", "yaw", "gripper"]},
    "language": {"delta_indices": [0], "modality_keys": ["annotation.human.action.task_description"]},
}


class N16:
    """How N1.6 writes arrays and modalities, the latter at first as text."""

    MARKER = "__ModalityConfig_class__"
    config = staticmethod(json.dumps)

    @staticmethod
    def array(value):
        file = io.BytesIO()
        np.save(file, value)
        return {"__ndarray_class__": True, "as_npy": file.getvalue()}


class N17:
    """How newer servers do, which use msgpack-numpy."""

    MARKER = "__ModalityConfig__"
    config = staticmethod(dict)

    @staticmethod
    def array(value):
        data = {b"type": value.dtype.str, b"kind": b"", b"shape": value.shape, b"data": value.tobytes()}
        return {b"nd": True} | data


def read(frame):
    def arrays(value):
        return np.load(io.BytesIO(value["as_npy"]), allow_pickle=False) if "__ndarray_class__" in value else value

    return msgpack.unpackb(frame, object_hook=arrays)


def chunk(observation, length=16):
    """A chunk whose x is the first pixel, y the number of the action, z the sum of the state; the gripper closes."""
    first = observation["video"]["image"][0, 0, 0, 0, 0] / 255
    numbers = {key: np.zeros((1, length, 1), np.float32) for key in LIBERO["action"]["modality_keys"]}
    numbers["x"][:] = first
    numbers["y"][0, :, 0] = np.arange(length)
    numbers["z"][:] = sum(part.sum() for part in observation["state"].values())
    numbers["gripper"][:] = 1.0
    return numbers


@contextlib.contextmanager
def serving(answer=None, modalities=LIBERO, writes=N16, token=None, seen=None, **endpoints):
    """A server that answers observations with `answer(observation)`, a chunk or a whole frame; yields its address.

    `endpoints` are other answers than those of the contract: values, frames, or functions of nothing.
    """
    context, stop = zmq.Context(), threading.Event()
    socket = context.socket(zmq.REP)
    socket.setsockopt(zmq.LINGER, 0)
    port = socket.bind_to_random_port("tcp://127.0.0.1")
    marked = {name: {writes.MARKER: True, "as_json": writes.config(config)} for name, config in modalities.items()}
    contract = {"ping": {"status": "ok", "message": "Server is running"}, "get_modality_config": marked, "reset": {}}

    def answered(message):
        if token is not None and message.get("api_token") != token:
            return {"error": "Unauthorized: Invalid API token"}
        name = message["endpoint"]
        if name == "get_action" and name not in endpoints:
            found = (answer or chunk)(message["data"]["observation"])
            return [found, {}] if isinstance(found, dict) else found
        found = (contract | endpoints)[name]
        return found() if callable(found) else found

    def serve():
        while not stop.is_set():
            if not socket.poll(20):
                continue
            message = read(socket.recv())
            if seen is not None:
                seen.append(message)
            try:
                found = answered(message)
            except Exception as error:
                found = {"error": str(error)}
            if found is None:  # dies
                break
            socket.send(found if isinstance(found, bytes) else msgpack.packb(found, default=writes.array))
        socket.close(linger=500 if stop.is_set() else 0)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"gr00t://127.0.0.1:{port}"
    finally:
        stop.set()
        thread.join(5)
        context.term()
