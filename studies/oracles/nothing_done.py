"""Episodes of the policy that does nothing in the suites that came last: whether each opens, is reset, steps and ends.

The runs stay in `runs/bench/nothing_done`, so that a second call plays what is missing. LIBERO's environment is needed.
"""

from collections.abc import Callable, Mapping

import pandas as pd

from robogauntlet.adapters import catalog
from robogauntlet.adapters.maniskill.assets import NEEDS
from studies.oracles.oracles import played
from studies.percent import few
from studies.shared import table_of
from studies.tables import write_episodes

FIELDS = ("task", "seed", "status", "steps", "wall_s")
EPISODES, HORIZON = 1000, 20
"""Least number of episodes of a suite, and their control steps."""
SUITE = """
name: nothing-done
policies: [zero]
tasks: {tasks}
seeds: {{start: 0, count: {count}}}
horizon: {horizon}
cameras: [third_person]
image_size: 96
render_profile: fast
"""
COLUMNS = {
    "suite": "{suite}",
    "tasks": "{tasks}",
    "episodes": "{episodes}",
    "errors": "{errors}",
    "successes": "{successes}",
    "an episode without opening its task, s: median / longest": "{median_s:.2f} / {longest_s:.1f}",
}


def _axis(axis: str) -> Callable[[str], bool]:
    return lambda task: task.startswith(f"libero/pro-{axis}-")


OF_ROBOMIMIC = tuple(f"robosuite/{name}" for name in ("ToolHang", "TwoArmTransport", "TwoArmPegInHole", "Wipe"))
SUITES: Mapping[str, tuple[str, Callable[[str], bool]]] = {
    **{f"LIBERO-PRO, {axis}": ("libero", _axis(axis)) for axis in ("object", "swap", "task", "language")},
    "ManiSkill, native numbers": ("maniskill", lambda task: _is_native(task) and not task.endswith(tuple(NEEDS))),
    "ALOHA and PushT": ("gymnasium", lambda task: task.startswith(("gymnasium/Aloha", "gymnasium/PushT"))),
    "robomimic's four of robosuite": ("robosuite", lambda task: task.startswith(OF_ROBOMIMIC)),
}
"""Titles to the simulator, and to which of its tasks they are."""


def measure() -> list[dict[str, object]]:
    """Play the first seeds of every task; writes the episodes beside the rows."""
    frames = []
    for number, suite in enumerate(SUITES):
        chosen = tasks_of(suite)
        text = SUITE.format(tasks=chosen, count=-(-EPISODES // len(chosen)), horizon=HORIZON)
        frames.append(played(f"nothing_done/{number}", text, FIELDS))
        print(f"{suite}: played", flush=True)
    frame = pd.concat(frames)
    write_episodes("nothing_done", frame, ("task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def tasks_of(suite: str) -> list[str]:
    """Return the tasks of a suite by their full names, without those that need a download; of a share, fewer."""
    simulator, belongs = SUITES[suite]
    found = [task for task in (f"{simulator}/{name}" for name in catalog.find(simulator).tasks) if belongs(task)]
    return found[: few(len(found), 1)]


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Return a row for each suite."""
    rows: list[dict[str, object]] = []
    for suite, (simulator, belongs) in SUITES.items():
        its = frame[frame.task.str.startswith(f"{simulator}/") & frame.task.map(belongs)]
        counts = {"tasks": its.task.nunique(), "episodes": len(its)}
        counts |= {"errors": int((its.status == "error").sum()), "successes": int((its.status == "success").sum())}
        times = {"median_s": float(its.wall_s.median()), "longest_s": float(its.wall_s.max())}
        rows.append({"suite": suite, **counts, **times})
    return rows


def _is_native(task: str) -> bool:
    simulator, _, name = task.partition("/")
    return bool(catalog.find(simulator).tasks[name].native)
