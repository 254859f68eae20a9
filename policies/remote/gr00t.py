"""A policy behind a policy server of Isaac GR00T, N1.6 or newer.

The contract is that of https://github.com/NVIDIA/Isaac-GR00T (`getting_started/policy.md`, Apache 2.0). The endpoint
`ping` says that the server is there, `get_modality_config` what it takes and gives, `reset` begins an episode, and
`get_action` answers `{video, state, language}`, batch and time first, with `[actions, info]`: arrays (1, n, columns).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from robogauntlet.adapters.contract import Image
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.conversion import MAX_ACTIONS, decode_chunk, encode_images, encode_proprioception
from robogauntlet.policies.remote.gr00t_modalities import fitted, modalities_in
from robogauntlet.policies.remote.gr00t_wire import Gr00tConnection, array_message
from robogauntlet.policies.remote.remote_policy import RemotePolicy
from robogauntlet.policies.remote.server_options import ACTIONS_KEY, ChunkKeys, Key, ServerOptions, StateKeys
from robogauntlet.suites.episode import CAMERAS


class Gr00tOptions(ServerOptions):
    """The options of the kind `gr00t`. The server's modalities say those keys that are not given."""

    PROTOCOL: ClassVar[str] = "gr00t"
    FORM: ClassVar[str] = "gr00t://HOST:PORT"
    SCHEMES: ClassVar[Mapping[str, str]] = {"gr00t": "gr00t"}
    PATH: ClassVar[str | None] = None
    EXTRA: ClassVar[str] = "gr00t"
    ASKS_UNITS: ClassVar[bool] = True
    UNUSED: ClassVar[frozenset[str]] = frozenset({"token_scheme"})

    address: str
    """gr00t://HOST:PORT"""
    cameras: dict[str, Key] = Field(default=dict(zip(CAMERAS, ("image", "wrist_image"), strict=True)))
    """camera to its key in video; by default those of LIBERO that the server asks for"""
    proprioception: StateKeys = None
    """keys of state, each with the columns of the eight numbers, or of joints and gripper, that it gets; by default
    those of LIBERO with its convention"""
    instruction: Key | None = None
    """key of the goal in words; by default the server's"""
    actions: ChunkKeys = ACTIONS_KEY
    """keys of the answer whose columns are put side by side; by default all, in the server's order"""

    def _keys_beside_each_other(self) -> list[list[str]]:
        return [[*self.cameras.values()]]


class Gr00tPolicy(RemotePolicy):
    """Asks a policy server of GR00T, one query at a time. Deterministic if the server is."""

    _connection: Gr00tConnection

    def __init__(self, options: ServerOptions) -> None:
        """Connect, unless `options.identity` names the policy."""
        self._fitted = options
        """The options with what the server's modalities say."""
        super().__init__(options)
        execute, cameras = options.execute or MAX_ACTIONS, tuple(self._fitted.cameras)
        self.spec = PolicySpec(PolicyInput.OBSERVATION, execute, options.action_dim, cameras, moves=options.moves)

    def images_sent(self, query: Query) -> Mapping[str, Image]:
        """Return the images of a query as the server gets them, by its keys."""
        self._connection.connect()  # its modalities say which are sent
        assert query.observation is not None
        return encode_images(self._fitted, query.observation, query.episode)

    def _new_connection(self) -> Gr00tConnection:
        return Gr00tConnection(self._options, self._accept)

    def _who(self) -> dict[str, Any]:
        return {**super()._who(), "address": self._options.address}  # modalities name an embodiment, not its weights

    def _silence(self) -> str:
        return "names no checkpoint"

    def _read_metadata(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        try:
            self._fitted = fitted(self._options, modalities_in(message))
        except PolicyMismatch as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None
        return message

    def _decide(self, query: Query) -> Decision:
        if query.step == 0:
            self._connection.ask(lambda: [self._connection.question("reset", {"options": None})])
        answer = self._connection.ask(lambda: [self._question(query)])
        try:
            return Decision(decode_chunk(self._fitted, self._first_of_batch(answer), query.action_dim))
        except PolicyMismatch as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None

    def _question(self, query: Query) -> bytes:
        assert query.observation is not None
        seen, options = query.observation, self._fitted
        images = encode_images(options, seen, query.episode)
        numbers = encode_proprioception(options, seen, query.episode)
        observation = {
            "video": {key: array_message(image[None, None]) for key, image in images.items()},
            "state": {key: array_message(part[None, None].astype(np.float32)) for key, part in numbers.items()},
            "language": {options.instruction: [[seen.instruction]]},
        }
        return self._connection.question("get_action", {"observation": observation, "options": None})

    def _first_of_batch(self, answer: Any) -> dict[str, Any]:
        """Return the chunks (n, columns) of an answer. Raises PolicyError for another shape."""
        actions = answer[0] if isinstance(answer, list) and answer else None
        if not isinstance(actions, dict):
            got = type(answer).__name__
            raise PolicyError(f"{self._server}: expected a list of actions and information, got {got}")
        chunks = {}
        for key, array in actions.items():
            if isinstance(array, np.ndarray) and (array.ndim != 3 or len(array) != 1):
                raise PolicyMismatch(f"expected a chunk of shape (1, n, columns) as '{key}', got {array.shape}")
            chunks[key] = array[0] if isinstance(array, np.ndarray) else array
        return chunks
