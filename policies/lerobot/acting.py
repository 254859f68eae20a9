"""A policy that LeRobot computes in a process of its own."""

from __future__ import annotations

import contextlib
import selectors
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from adapters.contract import FloatArray
from policies.contract import Decision, PolicyError, PolicyMismatch, Query
from policies.lerobot import child
from policies.lerobot.card import NAME, Checkpoint
from policies.remote.acting import card_chunk, card_message
from policies.remote.packing import PackingError
from suites.vocabulary import Episode, content_hash

LOADING = 10.0
"""Times an answer's limit that loading may take."""


class ProcessLost(Exception):
    """With the process went what it remembered of an episode. The episode can be played again."""


class LeRobotPolicy:
    """Asks a process that holds the checkpoint. One that has ended is started again with the next episode."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        """Start the process.

        Args:
            checkpoint: What to play.

        Raises:
            PolicyError: It cannot be loaded.
            ProcessLost: The process ended, or took too long.
        """
        self.spec, self._checkpoint = checkpoint.spec, checkpoint
        self._process: _Process | None = _Process(checkpoint)
        self._began: dict[str, _Process] = {}
        """Episode to the process that it was begun in."""
        self._over: list[str] = []

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes."""
        self.finish(episodes)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """LeRobot's answers.

        Raises:
            PolicyError: The checkpoint cannot be loaded, or its answer is not what the card says.
            ProcessLost: The process has ended, or does not answer.
        """
        return [self._decide(query) for query in queries]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Forget these episodes; the process is told with the next query."""
        self._over += [episode.id for episode in episodes if self._began.pop(episode.id, None) is not None]

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
        self._process = None

    def _decide(self, query: Query) -> Decision:
        if self._process is None or not self._process.alive:
            if query.episode.id in self._began:
                raise ProcessLost("LeRobot's process ended while the episode was under way")
            self.close()
            self._process = _Process(self._checkpoint)
        if self._began.setdefault(query.episode.id, self._process) is not self._process:
            raise ProcessLost("LeRobot's process ended while the episode was under way")
        card, seen = self._checkpoint.card, query.observation
        assert seen is not None
        arrays = card_message(card, seen, query.episode.task)
        if card.proprioception is not None:
            arrays[card.proprioception] = arrays[card.proprioception].astype(np.float32)
        seed = int(content_hash([query.episode.id, query.step]), 16) % 2**63
        message = {"episode": query.episode.id, "seed": seed, "task": seen.instruction, "over": self._over}
        answer = self._process.ask(message, arrays)
        self._over = []
        try:
            chunk: FloatArray = card_chunk(card, {card.actions: answer["action"]})
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"policy '{NAME}': {error}") from None
        return Decision(chunk)


class _Process:
    """A process with the checkpoint loaded. It ends when we do: its input is closed then."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        card = checkpoint.card
        if card.python is None and find_spec("lerobot") is None:
            raise PolicyError(f"policy '{NAME}': expected LeRobot; install it: gauntlet env create {NAME}")
        command = [card.python or sys.executable, "-P", child.__file__, str(checkpoint.folder), card.device]
        self._limit_s = card.timeout_s
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  closed in close
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said, start_new_session=True
            )
        except OSError as error:
            self._said.close()
            raise PolicyError(f"policy '{NAME}': {card.python} cannot be started: {error.strerror}") from None
        self._hear(LOADING * self._limit_s)

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def ask(self, message: dict[str, Any], arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Its answer."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it has died; hearing says how
            child.send(self._process.stdin, message, arrays)
        return self._hear(self._limit_s)

    def _hear(self, limit_s: float) -> dict[str, np.ndarray]:
        assert self._process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            if not selector.select(limit_s):
                self.close()
                raise ProcessLost(f"policy '{NAME}': expected an answer within {limit_s:g} s, none came")
        came = child.receive(self._process.stdout)
        if came is None:
            code = self._process.wait()
            last = self._last()
            self.close()
            raise ProcessLost(f"policy '{NAME}': its process ended with code {code}: {last}")
        message, arrays = came
        if "problem" in message:
            raise PolicyError(f"policy '{NAME}': {message['problem']}")
        return arrays

    def _last(self) -> str:
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").strip().splitlines() or ["no message"]
        return lines[-1]

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._said):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):
            self.close()
