"""A policy that LeRobot computes in a child process."""

from __future__ import annotations

import base64
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import Image
from robogauntlet.policies.contract import Decision, PolicyError, PolicyMismatch, PolicyNotInstalled, Query
from robogauntlet.policies.lerobot import child
from robogauntlet.policies.lerobot.checkpoint import NAME, Checkpoint
from robogauntlet.policies.remote.conversion import decode_chunk, encode_observation, images_in
from robogauntlet.policies.remote.msgpack_numpy import PackingError, array_of
from robogauntlet.policies.remote.server_options import ACTIONS_KEY
from robogauntlet.suites.episode import Episode, content_hash
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild
from robogauntlet.support.errors import first_line
from robogauntlet.support.secret_variables import without_secrets

LOADING = 10.0
"""Time limit of loading, as a multiple of the limit of an answer."""


class ProcessLost(Exception):
    """The process ended, and the state of its episodes is lost. They can be played again."""


class LeRobotPolicy:
    """Queries a child process that holds the checkpoint. If it ended, the next episode starts another."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        """Start the process.

        Raises:
            PolicyError: The checkpoint cannot be loaded.
            ProcessLost: The process ended, or took too long.
        """
        self.spec, self._checkpoint = checkpoint.spec, checkpoint
        self._process: _Process | None = _Process(checkpoint)
        self._process_of: dict[str, _Process] = {}
        """Episode to the process that it started in."""
        self._finished: list[str] = []

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes."""
        self.finish(episodes)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Ask LeRobot each query.

        Raises:
            PolicyError: The checkpoint cannot be loaded, or its answer does not fit the options.
            ProcessLost: The process has ended, or does not answer.
        """
        return [self._decide(query) for query in queries]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Drop these episodes; the next query reports them to the process."""
        self._finished += [episode.id for episode in episodes if self._process_of.pop(episode.id, None) is not None]

    def images_sent(self, query: Query) -> Mapping[str, Image]:
        """Return the images of a query as LeRobot gets them, by the checkpoint's features."""
        assert query.observation is not None
        return images_in(encode_observation(self._checkpoint.options, query.observation, query.episode))

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
        self._process = None

    def _decide(self, query: Query) -> Decision:
        if self._process is None or not self._process.alive:
            if query.episode.id in self._process_of:
                raise ProcessLost("LeRobot's process ended during the episode")
            self.close()
            self._process = _Process(self._checkpoint)
        if self._process_of.setdefault(query.episode.id, self._process) is not self._process:
            raise ProcessLost("LeRobot's process ended during the episode")
        options, observation = self._checkpoint.options, query.observation
        assert observation is not None
        arrays = encode_observation(options, observation, query.episode)
        if options.proprioception is not None:
            state = arrays[options.proprioception].astype(np.float32)
            if len(state) != self._checkpoint.numbers:
                wanted = f"proprioception of {self._checkpoint.numbers} numbers"
                raise PolicyMismatch(f"policy '{NAME}': expected {wanted}, {query.episode.task} has {len(state)}")
            arrays[options.proprioception] = state
        seed = int(content_hash([query.episode.id, query.step]), 16) % 2**63
        message = {
            "episode": query.episode.id,
            "seed": seed,
            "task": observation.instruction,
            "finished": self._finished,
        }
        actions = self._process.act(message, arrays)
        self._finished = []
        try:
            return Decision(decode_chunk(options, {ACTIONS_KEY: actions}, query.action_dim))
        except PolicyMismatch as error:
            raise PolicyMismatch(f"policy '{NAME}': {error}") from None


class _Process(JsonChild):
    """A child process with the checkpoint loaded. It ends when this process does, since that closes its input."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        options = checkpoint.options
        if options.python is None and find_spec("lerobot") is None:
            raise PolicyNotInstalled(f"policy '{NAME}': not installed; install it: robogauntlet env create {NAME}")
        command = [options.python or sys.executable, "-P", child.__file__, str(checkpoint.folder), options.device]
        self._limit_s = options.timeout_s
        try:
            super().__init__(command, environment=without_secrets(os.environ, but=options.variables), own_group=True)
        except OSError as error:
            raise PolicyError(f"policy '{NAME}': {options.python} cannot be started: {error.strerror}") from None
        self._checked(lambda: self.receive(LOADING * self._limit_s))

    def act(self, message: dict[str, Any], arrays: dict[str, np.ndarray]) -> np.ndarray:
        """Return the actions of a query. Raises PolicyError, ProcessLost."""
        request = {**message, "arrays": {name: child.packed(a) for name, a in arrays.items()}}
        answer = self._checked(lambda: self.ask(request, self._limit_s))
        try:
            dtype, shape, data = answer["action"]
            return array_of(dtype, shape, base64.b64decode(data))
        except (KeyError, TypeError, ValueError, PackingError) as error:
            self.close()
            reason = f"expected an array of actions from its process, got something else: {first_line(error)}"
            raise PolicyError(f"policy '{NAME}': {reason}") from None

    def _checked(self, answering: Callable[[], Any]) -> dict[str, Any]:
        """Return the process's next answer."""
        try:
            answer = answering()
        except (ChildEnded, ChildTimeout) as error:
            self.close()
            raise ProcessLost(f"policy '{NAME}': {error}") from None
        if not isinstance(answer, dict):
            self.close()
            raise ProcessLost(f"policy '{NAME}': expected a mapping from its process, got {type(answer).__name__}")
        if "problem" in answer:
            raise PolicyError(f"policy '{NAME}': {answer['problem']}")
        return answer
