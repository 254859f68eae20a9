"""Successes of LIBERO's oracles on the fifty stored states of each task, within the task's horizon.

A run for each of LIBERO's suites stays in `runs/bench/libero-oracles`, so that a second call plays what is missing.
"""

from collections.abc import Mapping, Sequence

from robogauntlet.adapters.libero.simulation import STORED_STATES
from robogauntlet.adapters.libero.tasks import libero_tasks
from robogauntlet.policies.oracles.libero import SCRIPTS
from robogauntlet.results.record import EpisodeResult, Status
from tests.benchmarks.document import WRITTEN
from tests.benchmarks.shared import run_suite, stored_rows, table_of

FOLDER = WRITTEN / "libero-oracles"
ORDER = ("10", "goal", "spatial", "object")
SUITE = """
name: libero-oracles
policies: [oracle]
tasks: [{tasks}]
seeds: {{start: 0, count: {states}}}
workers: 1
"""


def measure() -> list[dict[str, object]]:
    """Play seeds 0 to 49 of every task with a script; nothing is rendered, as the oracle does not look."""
    played: list[EpisodeResult] = []
    for suite in ORDER:
        folder = FOLDER / suite
        folder.mkdir(parents=True, exist_ok=True)
        tasks = ", ".join(task for task in SCRIPTS if task.startswith(f"libero/{suite}-"))
        file = folder / "suite.yaml"
        file.write_text(SUITE.format(tasks=tasks, states=STORED_STATES), encoding="utf-8")
        run_suite(file, folder / "run")
        played += stored_rows(folder / "run")
    rows = rows_of(played)
    columns = {
        "task": "{task}",
        "successes": "{successes} of {episodes}",
        "median steps": "{steps}",
        "failed": "{failed}",
    }
    table_of(rows, columns)
    return rows


def rows_of(results: Sequence[EpisodeResult]) -> list[dict[str, object]]:
    """Return a row for each task, in LIBERO's order, with the seeds that were not solved."""
    by_task: Mapping[str, list[EpisodeResult]] = {f"libero/{name}": [] for name in libero_tasks()}
    for result in sorted(results, key=lambda result: result.seed):
        by_task[result.task].append(result)
    rows = []
    for task, played in by_task.items():
        if not played:
            continue
        steps = sorted(result.steps for result in played if result.status == Status.SUCCESS)
        failed = [result.seed for result in played if result.status != Status.SUCCESS]
        shown = {"steps": steps[len(steps) // 2] if steps else "-", "failed": ", ".join(map(str, failed)) or "-"}
        rows.append({"task": task.removeprefix("libero/"), "successes": len(steps), "episodes": len(played), **shown})
    return rows
