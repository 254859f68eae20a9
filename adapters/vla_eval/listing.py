"""Writes the declaration of a benchmark from what its class says, where its simulator is installed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.adapters.vla_eval.benchmark import Part
from robogauntlet.adapters.vla_eval.simulation import (
    EPISODE,
    IMAGES,
    WORDS,
    action_parts,
    make,
    missing_packages,
    result_of,
)
from robogauntlet.suites.episode import CAMERAS
from robogauntlet.support.errors import describe

STILL = {"binary_close_positive": -1.0, "binary_close_negative": 1.0}
"""Format of a part to the number with which nothing moves, if it is not 0: an open gripper."""
EPISODES = 3
"""Episodes of the first task whose sentences are compared."""


def listing(
    name: str, path: str, arguments: Mapping[str, Any], control_hz: float, tell: Callable[[str], object]
) -> str:
    """Return a module that declares the tasks of a benchmark. Starts an episode of each, to hear what it says.

    Args:
        name: Name of the simulator.
        path: `MODULE:CLASS`.
        arguments: Of the class.
        control_hz: Control steps per simulated second, which no class says.
        tell: Gets a line for each task that is opened.

    Raises:
        AdapterError: There is no such class, its simulator is missing, or no task opens.
    """
    with missing_packages(path):
        benchmark = make(path, arguments)
        parts = {}
        for key, part in action_parts(benchmark):
            low, high = part.range or (-math.inf, math.inf)
            parts[key] = Part(part.dims, low, high, STILL.get(part.format, 0.0))
        if unsized := [key for key, part in parts.items() if not part.size]:
            tell(f"{path} does not say how many numbers its action '{unsized[0]}' has: write it into Part(0)")
        sentences: dict[str, str] = {}
        said: set[str] = set()
        seen: Mapping[str, Any] = {}
        for task in benchmark.get_tasks():
            for episode in range(1 if seen else EPISODES):
                try:
                    result_of(benchmark.start_episode({**task, EPISODE: episode}))
                    seen = result_of(benchmark.get_observation())
                except ImportError:
                    raise
                except Exception as error:  # a task may lack files
                    tell(f"{task['name']}: left out: {describe(error)}")
                    break
                sentence = " ".join(str(seen.get(WORDS) or "").split())
                sentences.setdefault(task["name"], sentence)
                said |= {sentence} if len(sentences) == 1 else set()
            else:
                tell(task["name"])
        metadata = benchmark.get_metadata()
        benchmark.cleanup()
    if not sentences:
        raise AdapterError(f"{path}: expected a task that opens or more, it has none with these arguments")
    state = {
        key: value.size
        for key, value in seen.items()
        if key != IMAGES and isinstance(value, np.ndarray) and value.dtype.kind in "biuf"
    }
    cameras = dict(zip(CAMERAS, seen.get(IMAGES) or (), strict=False))
    lines = {
        "tasks": _mapping(sentences),
        "action": _mapping(parts),
        "state": _mapping(state),
        "cameras": _mapping(cameras),
        "horizon": repr(metadata.get("max_steps", 300)),
        "control_hz": repr(control_hz),
        **({"arguments": repr(dict(arguments))} if arguments else {}),
        **({"start_states": repr(metadata["max_episodes_per_task"])} if "max_episodes_per_task" in metadata else {}),
        **({"own_words": "True"} if len(said) > 1 else {}),
    }
    body = "".join(f"    {key}={value},\n" for key, value in lines.items())
    title = f"{path.partition(':')[2]} (vla-evaluation-harness)"
    return (
        f'"""{title}. Written by `robogauntlet new adapter`."""\n\n'
        "from robogauntlet.adapters.vla_eval import Part, declare\n\n"
        f"SIMULATOR = declare(\n    {name!r},\n    {title!r},\n    {path!r},\n{body})\n"
    )


def _mapping(values: Mapping[str, Any]) -> str:
    if not values:
        return "{}"
    written = "".join(f"        {key!r}: {_written(value)},\n" for key, value in values.items())
    return f"{{\n{written}    }}"


def _written(value: Any) -> str:
    if not isinstance(value, Part):
        return repr(value)
    bounded = math.isfinite(value.low) and math.isfinite(value.high)
    given = [str(value.size), *([f"{float(value.low)}, {float(value.high)}"] if bounded else [])]
    return f"Part({', '.join([*given, *([f'still={value.still}'] if value.still else [])])})"
