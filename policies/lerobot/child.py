"""Runs in a Python environment with LeRobot: loads a checkpoint and answers its parent in lines of JSON.

This file imports nothing of RoboGauntlet, which need not be installed there. The computation is LeRobot's own
(https://github.com/huggingface/lerobot, Apache 2.0): `lerobot.utils.control_utils.predict_action`, called as in its
evaluation.
"""

from __future__ import annotations

import base64
import contextlib
import copy
import json
import os
import sys
from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np

_OPERATORS = ("nms", "qnms")
"""Operators that torchvision describes on import, whether or not they could be loaded."""


def packed(array: np.ndarray) -> list[Any]:
    """Return an array as JSON: type, shape, and its bytes in base64."""
    return [array.dtype.str, array.shape, base64.b64encode(array.tobytes()).decode()]


def unpacked(described: list[Any]) -> np.ndarray:
    """Return the array that `packed` described."""
    dtype, shape, data = described
    return np.frombuffer(base64.b64decode(data), dtype).reshape(shape).copy()


def import_lerobot() -> SimpleNamespace:
    """Import all that a checkpoint needs, and return what is called, by name."""
    import torch

    torchvision_beside_any_torch(torch)
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    try:
        from lerobot.common.control_utils import predict_action
    except ModuleNotFoundError:  # LeRobot 0.4
        from lerobot.utils.control_utils import predict_action
    called = (PreTrainedConfig, get_policy_class, make_pre_post_processors, predict_action)
    return SimpleNamespace(torch=torch, **{one.__name__: one for one in called})


class Loaded:
    """A checkpoint as LeRobot loads it, with its own pre- and post-processing."""

    def __init__(self, folder: str, device: str) -> None:
        names = import_lerobot()
        self._torch, self._device = names.torch, names.torch.device(device)
        config = names.PreTrainedConfig.from_pretrained(folder)
        config.device = device
        with weights_loaded(names.torch.nn.Module) as into:
            self._policy = names.get_policy_class(config.type).from_pretrained(folder, config=config)
        if not any(module is self._policy for module in into):
            raise ValueError("expected weights that fit its config.json in model.safetensors, LeRobot cannot load them")
        self._policy.eval()
        moved = {"device_processor": {"device": device}}
        self._before, self._after = names.make_pre_post_processors(
            config, pretrained_path=folder, preprocessor_overrides=moved
        )
        self._predict, self._config = names.predict_action, config
        self._episodes: dict[str, Any] = {}
        self.actions = 1 if observes_every_step(vars(config)) else int(getattr(config, "n_action_steps", 1))
        """Number of actions in an answer."""

    def act(self, episode: str, seed: int, task: str, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Return actions, shape (n, dim), in the checkpoint's units."""
        if episode not in self._episodes:
            self._episodes[episode] = self._copy()
        policy = self._episodes[episode]
        self._torch.manual_seed(seed)
        arguments = (policy, self._device, self._before, self._after, bool(self._config.use_amp))
        rows = [self._predict(dict(observation), *arguments, task=task) for _ in range(self.actions)]
        return np.concatenate([row.cpu().numpy() for row in rows])

    def forget(self, episodes: list[str]) -> None:
        """Drop the state of these episodes."""
        for episode in episodes:
            self._episodes.pop(episode, None)

    def _copy(self) -> Any:
        """A policy with the same weights and its own state."""
        twin = copy.copy(self._policy)
        if hasattr(twin, "temporal_ensembler"):
            twin.temporal_ensembler = copy.deepcopy(twin.temporal_ensembler)
        twin.reset()
        return twin


def observes_every_step(config: dict[str, Any]) -> bool:
    """Whether a policy's actions depend on more than the observation at the start of a chunk."""
    return config.get("n_obs_steps", 1) > 1 or config.get("temporal_ensemble_coeff") is not None


@contextlib.contextmanager
def weights_loaded(module: Any) -> Iterator[list[Any]]:
    """Yield the modules that get weights meanwhile.

    LeRobot's pi0, pi0-FAST and pi0.5 print that they cannot load weights, and would act with random ones.
    """
    original, into = module.load_state_dict, []

    def noting(self: Any, *arguments: Any, **more: Any) -> Any:
        loaded = original(self, *arguments, **more)
        into.append(self)
        return loaded

    module.load_state_dict = noting
    try:
        yield into
    finally:
        module.load_state_dict = original


def torchvision_beside_any_torch(torch: Any) -> None:
    """Make torchvision importable without its compiled operators: those of PyPI need CUDA, which torch may lack.

    No policy calls these operators; calling them fails.
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


def _answers(requests: Iterable[str]) -> Iterator[dict[str, Any]]:
    """Yield an answer when the checkpoint is loaded, and one to each request."""
    try:
        loaded = Loaded(*sys.argv[1:3])
        yield {"actions": loaded.actions}
    except Exception as error:  # whatever a checkpoint or its libraries raise
        yield {"problem": _described(error)}
        return
    for request in map(json.loads, requests):
        observation = {name: unpacked(described) for name, described in request["arrays"].items()}
        loaded.forget(request["finished"])
        try:
            rows = loaded.act(request["episode"], request["seed"], request["task"], observation)
            yield {"action": packed(rows)}
        except Exception as error:
            yield {"problem": _described(error)}


def _described(error: Exception) -> str:
    lines = str(error).strip().splitlines() or ["no message"]
    return f"{type(error).__name__}: {lines[0]}"


if __name__ == "__main__":
    with os.fdopen(int(sys.argv[-1]), "w") as stream:  # see robogauntlet.support.child_process
        for answer in _answers(sys.stdin):
            stream.write(json.dumps(answer) + "\n")
            stream.flush()
