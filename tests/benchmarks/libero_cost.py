"""Processor time of an episode in LIBERO with images, the oracle's included, before and after the speed-ups.

To be run by the Python of `robogauntlet env create libero`.
"""

import statistics
import time
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.policies.oracles import scripts
from robogauntlet.suites.episode import SUCCESS_HOLD, RenderProfile, View
from tests.benchmarks.libero_frames import TASKS
from tests.benchmarks.shared import open_task, speed_up, table_of

SEEDS = 3
KINDS = {
    "every_step": (RenderProfile.FAST, False, 1),
    "before": (RenderProfile.FAST, False, 4),
    "after": (RenderProfile.FAST_2, True, 4),
}
"""Render profile, whether sped up, and control steps per observation."""
COLUMNS = {
    "task": "{task}",
    "steps": "{steps:.0f}",
    "core hours of 1,000 episodes: images of all steps": "{every_step:.2f}",
    "images of every fourth step": "{before:.2f}",
    "the same by `fast-2` and compiled steps": "{after:.2f}",
    "of the first": "{share}",
}


def measure() -> list[dict[str, object]]:
    """Core hours of a thousand episodes with two images of 96 px, by the median of a few seeds."""
    rows: list[dict[str, object]] = []
    for task in TASKS:
        spent, steps = {}, []
        for kind, (profile, wanted, every) in KINDS.items():
            simulation: Any = open_task(task, View(image_size=96, render_profile=profile))
            speed_up(simulation, wanted=wanted)
            play(simulation, task, SEEDS, every)  # what is compiled at first use
            times = []
            for seed in range(SEEDS):
                start = time.process_time()
                steps.append(play(simulation, task, seed, every))
                times.append(time.process_time() - start)
            simulation.close()
            spent[kind] = 1000 * statistics.median(times) / 3600
        share = f"{100 * spent['after'] / spent['every_step']:.0f} %"
        rows.append({"task": task, "steps": statistics.median(steps), **spent, "share": share})
    table_of(rows, COLUMNS)
    return rows


def play(simulation: Any, task: str, seed: int, every: int) -> int:
    """Play the oracle's episode, observe every so many steps, and return the number of steps."""
    simulation.reset(seed)
    script = scripts()[task]()
    held = steps = 0
    while held < SUCCESS_HOLD and steps < catalog.task_descriptions()[task].horizon:
        if steps % every == 0:
            simulation.observe()
        outcome = simulation.step(script(simulation.privileged_state()))
        held = held + 1 if outcome.success else 0
        steps += 1
    return steps
