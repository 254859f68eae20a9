"""Run by the Python of an environment with LeRobot: loads a checkpoint, and answers what its parent asks over pipes.

A message is a line of JSON, whose `arrays` name, type and shape what follows it in bytes. This file imports nothing of
RoboGauntlet, which need not be there. What computes is LeRobot (https://github.com/huggingface/lerobot, Apache 2.0):
`lerobot.utils.control_utils.predict_action`, as its own evaluation calls it.
"""

from __future__ import annotations

import copy
import json
import os
import sys
from typing import IO, Any

import numpy as np

_OPERATORS = ("nms", "qnms")
"""Of torchvision, which it describes on import, whether or not they could be loaded."""


def send(stream: IO[bytes], message: dict[str, Any], arrays: dict[str, np.ndarray] | None = None) -> None:
    """Write a message. Raises OSError if nobody reads."""
    whole = {name: np.ascontiguousarray(array) for name, array in (arrays or {}).items()}
    described = [[name, array.dtype.str, array.shape] for name, array in whole.items()]
    stream.write(json.dumps({**message, "arrays": described}).encode() + b"\n")
    for array in whole.values():
        stream.write(array.tobytes())
    stream.flush()


def receive(stream: IO[bytes]) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """The next message, or None if there will be none. Raises ValueError if it is none."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    message = json.loads(line)
    arrays = {}
    for name, dtype, shape in message.pop("arrays"):
        size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
        data = stream.read(size)
        if len(data) < size:
            return None
        arrays[name] = np.frombuffer(data, np.dtype(dtype)).reshape(shape).copy()
    return message, arrays


class Loaded:
    """A checkpoint as LeRobot loads it, with its own pre- and post-processing."""

    def __init__(self, folder: str, device: str) -> None:
        """Args: folder: with config.json, model.safetensors and the processors; device: such as `cpu`."""
        import torch

        self._torch, self._device = torch, torch.device(device)
        torchvision_beside_any_torch(torch)
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors
        from lerobot.utils.control_utils import predict_action

        config = PreTrainedConfig.from_pretrained(folder)
        config.device = device
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config)
        self._policy.eval()
        moved = {"device_processor": {"device": device}}
        self._before, self._after = make_pre_post_processors(
            config, pretrained_path=folder, preprocessor_overrides=moved
        )
        self._predict, self._config = predict_action, config
        self._episodes: dict[str, Any] = {}
        self.actions = 1 if looks_every_step(vars(config)) else int(getattr(config, "n_action_steps", 1))
        """That an answer has."""

    def act(self, episode: str, seed: int, task: str, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Actions, shape (n, dim), in the checkpoint's units."""
        if episode not in self._episodes:
            self._episodes[episode] = self._fresh()
        policy = self._episodes[episode]
        self._torch.manual_seed(seed)
        rows = [
            self._predict(
                dict(seen), policy, self._device, self._before, self._after, bool(self._config.use_amp), task=task
            )
            for _ in range(self.actions)
        ]
        return np.concatenate([row.cpu().numpy() for row in rows])

    def forget(self, episodes: list[str]) -> None:
        """These episodes are over."""
        for episode in episodes:
            self._episodes.pop(episode, None)

    def _fresh(self) -> Any:
        """The same weights, with what it remembers of an episode apart from other episodes'."""
        twin = copy.copy(self._policy)
        if hasattr(twin, "temporal_ensembler"):
            twin.temporal_ensembler = copy.deepcopy(twin.temporal_ensembler)
        twin.reset()
        return twin


def looks_every_step(config: dict[str, Any]) -> bool:
    """Whether a policy's action depends on more than what is seen when its chunk begins."""
    return config.get("n_obs_steps", 1) > 1 or config.get("temporal_ensemble_coeff") is not None


def torchvision_beside_any_torch(torch: Any) -> None:
    """Let torchvision be imported where its compiled operators cannot be: PyPI's are for CUDA, this torch may not be.

    No policy here calls them; calling them fails.
    """
    try:
        import torchvision  # noqa: F401
    except RuntimeError:
        for name in [name for name in sys.modules if name.partition(".")[0] == "torchvision"]:
            del sys.modules[name]
        for name in _OPERATORS:
            described = f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
            _KEPT.append(torch.library.Library("torchvision", "FRAGMENT"))
            _KEPT[-1].define(described)


_KEPT: list[Any] = []


def _main() -> None:
    """Answer until nobody asks. What the libraries print goes to standard error."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    asked = sys.stdin.buffer
    try:
        loaded = Loaded(*sys.argv[1:3])
    except Exception as error:  # whatever a checkpoint or its libraries raise
        send(answers, {"problem": _said(error)})
        return
    send(answers, {"actions": loaded.actions})
    while (came := receive(asked)) is not None:
        message, seen = came
        loaded.forget(message["over"])
        try:
            rows = loaded.act(message["episode"], message["seed"], message["task"], seen)
        except Exception as error:
            send(answers, {"problem": _said(error)})
        else:
            send(answers, {}, {"action": rows})


def _said(error: Exception) -> str:
    lines = str(error).strip().splitlines() or ["no message"]
    return f"{type(error).__name__}: {lines[0]}"


if __name__ == "__main__":
    _main()
