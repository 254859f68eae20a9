"""Serves an OpenVLA-OFT checkpoint of LIBERO in openpi's protocol, for `robogauntlet run --policy openpi://HOST:PORT`.

It runs in OpenVLA-OFT's own environment, in its repository's folder, with `pip install openpi-client websockets`:

    python openvla_oft_server.py moojink/openvla-7b-oft-finetuned-libero-spatial libero_spatial --port 8000

RoboGauntlet sends what its option `convention: libero` says: images as LIBERO's evaluations turn them, (size, size, 3)
uint8; the tool's pose in the world and both finger positions, (8,). The answer is a chunk of the checkpoint's actions,
(8, 7), whose gripper is 1 for open and 0 for closed.
"""

import argparse
from typing import Any

import numpy as np
from experiments.robot.libero.run_libero_eval import GenerateConfig, initialize_model
from experiments.robot.openvla_utils import resize_image_for_policy
from experiments.robot.robot_utils import get_action, get_image_resize_size
from openpi_client import msgpack_numpy
from websockets.sync.server import ServerConnection, serve

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("checkpoint", help="folder, or repository on the Hugging Face hub")
parser.add_argument("suite", help="libero_spatial, libero_object, libero_goal or libero_10")
parser.add_argument("--port", type=int, default=8000)
arguments = parser.parse_args()
config = GenerateConfig(pretrained_checkpoint=arguments.checkpoint, task_suite_name=arguments.suite)
model, action_head, projector, noisy_projector, processor = initialize_model(config)
size = get_image_resize_size(config)


def actions(message: dict[str, Any]) -> np.ndarray:
    """Return the chunk for an observation in openpi's keys."""
    observation = {
        "full_image": resize_image_for_policy(message["observation/image"], size),
        "wrist_image": resize_image_for_policy(message["observation/wrist_image"], size),
        "state": message["observation/state"],
    }
    heads = {"action_head": action_head, "proprio_projector": projector, "noisy_action_projector": noisy_projector}
    prompt = message["prompt"]
    return np.stack(get_action(config, model, observation, prompt, processor=processor, use_film=False, **heads))


def answer(connection: ServerConnection) -> None:
    """Say whose checkpoint it is, then answer each query."""
    packer = msgpack_numpy.Packer()
    connection.send(packer.pack({"checkpoint": arguments.checkpoint, "suite": arguments.suite}))
    for frame in connection:
        connection.send(packer.pack({"actions": actions(msgpack_numpy.unpackb(frame))}))


with serve(answer, "127.0.0.1", arguments.port, compression=None, max_size=None) as server:
    print(f"ws://127.0.0.1:{server.socket.getsockname()[1]} serves {arguments.checkpoint}", flush=True)
    server.serve_forever()
