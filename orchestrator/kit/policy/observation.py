"""Findings about what a policy looks at: its answers when a part of the observation is changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from robogauntlet.adapters.catalog import body_of
from robogauntlet.adapters.contract import FloatArray, Image, Observation
from robogauntlet.orchestrator.kit.finding import Finding, Level, percent
from robogauntlet.orchestrator.kit.policy.recording import Answer, InvalidAnswer, ask_again
from robogauntlet.policies.contract import Policy, Query

QUERIES = 3
"""Queries of an episode, from its first on, that are asked again."""
OTHER_INSTRUCTION = "do nothing"
NOISY = 0.2
"""Answers to the same observation that differ by more than this hide what a policy looks at."""
MARGIN = 1.5
"""A change must exceed that of answers to the same observation by this factor."""
Change = Callable[[Observation], Observation]


def changes(cameras: Sequence[str]) -> dict[str, Change]:
    """Return each change of an observation by its name."""
    of_cameras: dict[str, Change] = {}
    if len(cameras) > 1:
        of_cameras = {f"{camera} black": _images(_black, camera) for camera in cameras}
    return {
        "all images black": _images(_black),
        **of_cameras,
        "images upside down": _images(lambda image: image[::-1].copy()),
        "images mirrored left-right": _images(lambda image: image[:, ::-1].copy()),
        "other proprioception": lambda seen: replace(seen, proprioception=np.zeros_like(seen.proprioception)),
        "other instruction": lambda seen: replace(seen, instruction=OTHER_INSTRUCTION),
    }


def _images(change: Callable[[Image], Image], only: str | None = None) -> Change:
    def changed(seen: Observation) -> Observation:
        images = {name: change(image) if only in (None, name) else image for name, image in seen.images.items()}
        return replace(seen, images=images)

    return changed


def _black(image: Image) -> Image:
    return np.zeros_like(image)


def sensitivity(policy: Policy, answers: Sequence[Answer]) -> Iterator[Finding]:
    """Ask the first queries of an episode again, with changed observations.

    Raises:
        InvalidAnswer: The policy raised, or its answer is not an action chunk, although nothing was changed.
    """
    asked = answers[:QUERIES]
    assert asked[0].query.observation is not None

    def answers_to(change: Change) -> list[FloatArray]:
        chunks = ask_again(policy, asked, change)
        return [chunk - _origin(answer.query) for chunk, answer in zip(chunks, asked, strict=True)]

    same = answers_to(lambda seen: seen)
    noise = difference(same, answers_to(lambda seen: seen))
    if noise > NOISY:
        text = (
            f"the actions change by {percent(noise)} although nothing is changed, which hides what the policy looks at"
        )
        yield Finding("input", Level.WARNING, text, {"relative_change_unchanged": noise})
        return
    cameras = list(asked[0].query.observation.images)
    effects: dict[str, float] = {}
    for name, change in changes(cameras).items():
        try:
            effects[name] = difference(same, answers_to(change))
        except InvalidAnswer as error:
            yield Finding("input", Level.WARNING, f"{name}: {error}")
    blind = effects.get("all images black", np.inf) <= MARGIN * noise
    usual = f"the actions vary by {percent(noise)}, as without a change" if noise else "the same actions"
    for name, effect in effects.items():
        numbers = {"relative_change": effect, "relative_change_unchanged": noise}
        if effect > MARGIN * noise:
            text, level = f"the actions change by {percent(effect)} of their size", Level.NOTE
        elif name == "all images black":
            text, level = f"{usual}; the policy does not look at the images", Level.WARNING
        elif name.startswith("other"):
            text, level = f"{usual}; the policy does not use it", Level.NOTE
        elif blind:
            continue
        elif name.endswith(" black"):
            text, level = f"{usual}; the policy does not use this camera", Level.NOTE
        else:
            text, level = f"{usual}; the policy does not tell the difference", Level.WARNING
        yield Finding("input", level, f"{name}: {text}", numbers)


def _origin(query: Query) -> FloatArray | float:
    """The action from which the answer's size counts: targets of joints count from where the joints are."""
    assert query.observation is not None
    targets = query.observation.of_joints and not body_of(query.episode.task).velocities
    return np.append(query.observation.proprioception[:-1], 0.0) if targets else 0.0


def difference(chunks: Sequence[FloatArray], others: Sequence[FloatArray]) -> float:
    """Return the mean difference of the chunks' numbers, each relative to the root mean square of its component.

    Chunks of different length are compared over the shorter; components that are always 0 in the first are in units of
    the largest component.
    """
    pairs = [(one[: len(other)], other[: len(one)]) for one, other in zip(chunks, others, strict=True)]
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    sizes = np.sqrt((first**2).mean(axis=0))
    sizes[sizes == 0] = sizes.max() or 1.0
    changed = np.abs(second - first).mean(axis=0) / sizes
    moving = changed > 0
    return float(changed[moving].mean()) if moving.any() else 0.0
