"""A policy that asks a server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from PIL import Image as Picture
from scipy.spatial.transform import Rotation

from adapters.contract import ACTION_DIM, FloatArray, Image, Observation
from policies.contract import Decision, PolicyError, PolicyMismatch, PolicySpec, Query, Sees
from policies.remote import libero
from policies.remote.card import ACTIONS_KEY, Card, Convention
from policies.remote.episodes import Greeting, as_message, greeting_in, routing_in
from policies.remote.line import Line, packed
from policies.remote.packing import PackingError
from suites.vocabulary import Episode

MOST_ACTIONS = 1000
"""Of an answer."""


class ConnectionLost(Exception):
    """With the connection went what the server remembered of an episode. The episode can be played again."""


class RemotePolicy:
    """Asks a server of openpi's protocol, one query at a time. Deterministic if the server is."""

    def __init__(self, card: Card) -> None:
        """Args: card: the options. Connects, unless the card says who acts there."""
        self._card, self._line = card, Line(card)
        self._digest = ""
        self._greeting: Greeting | None = None
        self._seen = -1
        self._began: dict[str, int] = {}
        """Episode to the number of the connection that it is played over."""
        self._finished: list[str] = []
        if card.identity is None:
            self._line.connect()
            self._take_greeting()
            self._digest = self.digest()
        self.spec = self._spec()

    def digest(self) -> str:
        """Hash of what acts, see `docs/remote-policies.md`.

        Raises:
            PolicyError: The suite does not say what acts there, and neither does the server.
        """
        if self._card.identity is not None:
            return self._card.digest({"identity": self._card.identity})
        if self._is_ours:
            assert self._greeting is not None
            return self._greeting.digest
        if not self._line.metadata:
            raise PolicyError(
                f"policy server {self._card.address}: expected metadata that tell what acts there, got none; "
                "give option identity: a checkpoint's name or hash"
            )
        return self._card.digest({"metadata": _plain(self._line.metadata)})

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes; nothing is sent."""
        for episode in episodes:
            self._began.pop(episode.id, None)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """The server's answers.

        Raises:
            PolicyError: See `Line.ask`; or the answer is not what the card says.
            ConnectionLost: The server remembers, and was lost within the episode.
        """
        return [self._decide(query) for query in queries]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Forget these episodes; RoboGauntlet's server is told with the next query."""
        self._finished += [episode.id for episode in episodes if self._began.pop(episode.id, None) is not None]

    def close(self) -> None:
        """Hang up."""
        self._line.close()

    @property
    def _is_ours(self) -> bool:
        return self._greeting is not None and self._card.is_plain

    def _spec(self) -> PolicySpec:
        if self._is_ours and self._card.identity is None:
            assert self._greeting is not None
            return self._greeting.spec
        return card_spec(self._card)

    def _decide(self, query: Query) -> Decision:
        answer = self._line.ask(lambda: self._frame(query))
        self._began[query.episode.id] = self._line.made
        self._finished.clear()
        return self._read(answer)

    def _frame(self, query: Query) -> bytes:
        self._take_greeting()
        begun = self._began.get(query.episode.id, self._line.made) if query.step else self._line.made
        if begun != self._line.made and self._greeting is not None and self._greeting.remembers:
            raise ConnectionLost(f"policy server {self._card.address} was lost while the episode was under way")
        return packed(self._message(query))

    def _take_greeting(self) -> None:
        """Look at what the server said, if it is a new connection."""
        if self._seen == self._line.made:
            return
        try:
            self._greeting = greeting_in(self._line.metadata)
        except PackingError as error:
            self._line.close()
            raise PolicyError(f"policy server {self._card.address}: {error}") from None
        if self._digest and self.digest() != self._digest:
            self._line.close()
            raise PolicyError(
                f"policy server {self._card.address}: expected what the run was planned with, got another policy"
            )
        self._seen = self._line.made

    def _message(self, query: Query) -> dict[str, Any]:
        if self._is_ours:
            return as_message(query, self._finished)
        assert query.observation is not None
        message = card_message(self._card, query.observation, query.episode.task)
        if self._greeting is not None:
            whole = as_message(query, self._finished)
            message |= {key: whole[key] for key in whole if key.startswith("gauntlet/")}
        return message

    def _read(self, answer: Mapping[str, Any]) -> Decision:
        try:
            if self._is_ours:
                return Decision(_chunk(answer, ACTIONS_KEY, ACTION_DIM, exactly=True), routing_in(answer))
            return Decision(card_chunk(self._card, answer), routing_in(answer) if self._greeting else None)
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"policy server {self._card.address}: {error}") from None


def card_spec(card: Card) -> PolicySpec:
    """What a server that is asked by a card needs."""
    return PolicySpec(Sees.OBSERVATION, card.execute or MOST_ACTIONS, cameras=tuple(card.cameras))


def card_message(card: Convention, seen: Observation, task: str) -> dict[str, Any]:
    """An observation of a task under the server's keys.

    Raises:
        PolicyMismatch: The card's convention is of other tasks.
    """
    message: dict[str, Any] = {
        key: resized(card, turned(card, seen.images[camera])) for camera, key in card.cameras.items()
    }
    if card.proprioception is not None:
        own = card.convention == "robogauntlet"
        message[card.proprioception] = (
            seen.proprioception if own else libero.native_proprioception(task, seen.proprioception)
        )
    if card.instruction is not None:
        message[card.instruction] = seen.instruction
    return message


TURNS = {"none": (1, 1), "half": (-1, -1), "left-right": (1, -1), "upside-down": (-1, 1)}
"""Steps through an image's rows and columns."""


def turned(card: Convention, image: Image) -> Image:
    """An image (height, width, 3) as the card turns or mirrors it."""
    rows, columns = TURNS[card.turn]
    return np.ascontiguousarray(image[::rows, ::columns])


def resized(card: Convention, image: Image) -> Image:
    """An image in the card's size, bilinear; padded with black on both sides alike where the shape is another."""
    if card.image_size is None:
        return image
    height, width = card.image_size if isinstance(card.image_size, tuple) else (card.image_size,) * 2
    if image.shape[:2] == (height, width):
        return image
    picture = Picture.fromarray(image)
    if card.resize == "stretch":
        return np.asarray(picture.resize((width, height), Picture.Resampling.BILINEAR))
    factor = min(width / picture.width, height / picture.height)
    inner = max(1, int(picture.width * factor)), max(1, int(picture.height * factor))
    padded = Picture.new("RGB", (width, height))
    padded.paste(
        picture.resize(inner, Picture.Resampling.BILINEAR), ((width - inner[0]) // 2, (height - inner[1]) // 2)
    )
    return np.asarray(padded)


def card_chunk(card: Convention, answer: Mapping[str, Any]) -> FloatArray:
    """The chunk of an answer, shape (n, 7), in the units of `adapters.contract`.

    Raises:
        PolicyMismatch: It is missing, too short or too narrow, or holds what is not a finite number.
    """
    columns = card.columns or tuple(range(card.width))
    width = 1 + max((column for column in columns if column is not None), default=0)
    rows = _chunk(answer, card.actions, width, exactly=card.columns is None)
    if card.execute is not None:
        if len(rows) < card.execute:
            raise PolicyMismatch(f"expected {card.execute} actions or more, as option execute says, got {len(rows)}")
        rows = rows[: card.execute]
    read = np.stack([np.zeros(len(rows)) if column is None else rows[:, column] for column in columns], axis=1)
    rotations = as_axis_angles(card, read[:, 3:-1])
    chunk = np.concatenate([read[:, :3] * card.translation_scale, rotations, read[:, -1:]], axis=1)
    if columns[-1] is not None:
        span = card.gripper_closed - card.gripper_open
        if card.gripper_threshold is None and (card.gripper_open, card.gripper_closed) == (-1.0, 1.0):
            pass  # ours already: no rounding
        elif card.gripper_threshold is None:
            chunk[:, 6] = 2.0 * (chunk[:, 6] - card.gripper_open) / span - 1.0
        else:
            chunk[:, 6] = np.where((chunk[:, 6] - card.gripper_threshold) * span > 0, 1.0, -1.0)
    return chunk


def as_axis_angles(card: Convention, rotations: FloatArray) -> FloatArray:
    """An answer's rotations, (n, 3) or (n, 4), as axis-angle vectors, (n, 3), rad, of angles up to pi.

    Raises:
        PolicyMismatch: A quaternion is not of length 1, to within 0.01; rounding of float16 stays below that.
    """
    match card.rotation:
        case "axis-angle":
            return rotations * card.rotation_scale
        case "euler":
            return Rotation.from_euler("xyz", rotations * card.rotation_scale).as_rotvec()
    lengths = np.linalg.norm(rotations, axis=1)
    for row in np.flatnonzero(np.abs(lengths - 1.0) > 0.01):
        raise PolicyMismatch(
            f"expected quaternions of length 1 in '{card.actions}', got length {lengths[row]:.3g} in row {row}; "
            "see options rotation and columns"
        )
    return Rotation.from_quat(rotations, scalar_first=card.rotation.endswith("wxyz")).as_rotvec()


def _chunk(answer: Mapping[str, Any], key: str, width: int, *, exactly: bool) -> FloatArray:
    if key not in answer:
        there = ", ".join(sorted(map(str, answer)))[:200] or "nothing"
        raise PolicyMismatch(f"expected '{key}' in the answer, got {there}; set option actions")
    try:
        rows = np.asarray(answer[key])
    except ValueError:
        rows = np.empty(0, dtype=object)
    if rows.dtype.kind not in "iuf":
        raise PolicyMismatch(f"expected numbers as '{key}', got {type(answer[key]).__name__} of type {rows.dtype}")
    fits = rows.ndim == 2 and (rows.shape[1] == width if exactly else rows.shape[1] >= width)
    if not fits or not 1 <= len(rows) <= MOST_ACTIONS:
        wanted = f"{width}" if exactly else f"{width} or more"
        hint = "; say by option columns which are ours" if rows.ndim == 2 and exactly else ""
        raise PolicyMismatch(
            f"expected '{key}' of shape (n, {wanted}), n from 1 to {MOST_ACTIONS}, got {rows.shape}{hint}"
        )
    rows = rows.astype(np.float64)
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0]
        raise PolicyMismatch(
            f"expected finite numbers as '{key}', got {rows[row, column]} in row {row}, column {column}"
        )
    return rows


def _plain(value: Any) -> Any:
    """Metadata as JSON holds them."""
    match value:
        case dict():
            return {str(key): _plain(one) for key, one in value.items()}
        case list() | tuple():
            return [_plain(one) for one in value]
        case np.ndarray() | np.generic():
            return _plain(value.tolist())
        case None | bool() | int() | str():
            return value
        case _:
            return repr(value)
