"""Model servers of vla-evaluation-harness in its own software, on free ports; prints `{name: port}`."""

import functools
import json

import anyio
import numpy as np
from vla_eval import specs
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve_async

LIBEROS = {"position": specs.POSITION_DELTA, "rotation": specs.ROTATION_AA, "gripper": specs.GRIPPER_CLOSE_POS}


class Chunks(PredictModelServer):
    """A chunk has the first pixel of the image that it was made for, the number of the action, and the step."""

    def get_action_spec(self):
        return LIBEROS

    def get_observation_spec(self):
        return {"image": specs.IMAGE_RGB, "language": specs.LANGUAGE}

    def predict(self, obs, ctx):
        actions = np.zeros((4, 7))
        actions[:, 0] = obs["images"]["agentview"][0, 0, 0] / 255
        actions[:, 1] = np.arange(4) / 10
        actions[:, 2] = ctx.step / 100
        actions[:, 6] = 1
        return {"actions": actions}


class Turned(Chunks):
    """Its gripper closes at -1."""

    def get_action_spec(self):
        return LIBEROS | {"gripper": specs.GRIPPER_CLOSE_NEG}


class Unsaid(Chunks):
    """It says nothing of its numbers, as pi0's and LeRobot's."""

    def get_action_spec(self):
        return {"actions": specs.RAW}


class Shown(Chunks):
    """It answers with what it is shown."""

    def get_observation_params(self):
        return {"send_wrist_image": True, "send_state": True}

    def predict(self, obs, ctx):
        pixels = [obs["images"][camera][0, 1, 2] / 255 for camera in ("agentview", "wrist")]
        named = sorted(obs) == ["images", "state", "task_description"] and list(obs["images"]) == ["agentview", "wrist"]
        sizes = len(obs["task_description"]) / 100, obs["state"].sum() / 100
        return {"actions": np.array([*pixels, *sizes, float(named), 0.0, 1.0])}


class Raising(Chunks):
    """It fails at the second step, and at the start of episodes of one instruction."""

    async def on_episode_start(self, config, ctx):
        if config["task"]["name"] == "refuse":
            raise ValueError("no such task\nat all")
        await super().on_episode_start(config, ctx)

    def predict(self, obs, ctx):
        if ctx.step:
            raise KeyError("joints")
        return {"actions": np.zeros(7)}


SERVERS = {
    "chunks": lambda: Chunks(chunk_size=4),
    "whole chunks": Chunks,
    "turned": lambda: Turned(chunk_size=4),
    "unsaid": lambda: Unsaid(chunk_size=4),
    "shown": Shown,
    "raising": Raising,
}


async def main():
    async with anyio.create_task_group() as group:
        start = {name: functools.partial(serve_async, make(), "127.0.0.1", 0) for name, make in SERVERS.items()}
        print(json.dumps({name: await group.start(serve) for name, serve in start.items()}), flush=True)


if __name__ == "__main__":
    anyio.run(main)
