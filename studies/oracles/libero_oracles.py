"""Successes of LIBERO's oracles on the fifty stored states of each task, within the task's horizon.

The run stays in `runs/bench/libero-oracles`, so that a second call plays what is missing.
"""

import pandas as pd

from robogauntlet.adapters.catalog import original
from robogauntlet.adapters.libero.tasks import STORED_STATES, libero_tasks
from robogauntlet.policies.oracles.libero import SCRIPTS
from robogauntlet.results.api import open_run
from studies.percent import few
from studies.shared import run_suite, table_of
from studies.tables import WRITTEN, write_episodes

FOLDER = WRITTEN / "libero-oracles"
FIELDS = ("task", "seed", "status", "steps", "success_once", "state_hash", "actions_hash", "policy_digest")
SUITE = """
name: libero-oracles
policies: [oracle]
tasks: [{tasks}]
seeds: {{start: 0, count: {states}}}
workers: 1
"""


def measure() -> list[dict[str, object]]:
    """Play seeds 0 to 49 of every task with a script; nothing is rendered, as the oracle does not look."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    suite = FOLDER / "suite.yaml"
    tasks = [task for task in SCRIPTS if original(task) == task]
    chosen = ", ".join(reversed(tasks[: few(len(tasks))]))
    suite.write_text(SUITE.format(tasks=chosen, states=STORED_STATES), encoding="utf-8")
    run_suite(suite, FOLDER / "run")
    episodes = open_run(FOLDER / "run").episodes(FIELDS)
    write_episodes("libero_oracles", episodes, ("task", "seed"))
    rows = rows_of(episodes)
    columns = {
        "task": "{task}",
        "successes": "{successes} of {episodes}",
        "median steps": "{steps}",
        "seeds not solved": "{failed}",
    }
    table_of(rows, columns)
    return rows


def rows_of(episodes: pd.DataFrame) -> list[dict[str, object]]:
    """Return a row for each task, in LIBERO's order, with the seeds that were not solved."""
    rows = []
    for name in libero_tasks():
        played = episodes[episodes.task == f"libero/{name}"].sort_values("seed")
        if played.empty:
            continue
        solved = played.status == "success"
        steps = f"{played.steps[solved].median():.0f}" if solved.any() else "-"
        failed = ", ".join(map(str, played.seed[~solved])) or "-"
        counts = {"successes": int(solved.sum()), "episodes": len(played)}
        rows.append({"task": name, **counts, "steps": steps, "failed": failed})
    return rows
