"""The same episodes of the same policy with one worker and with two, alternating."""

from robogauntlet.results.record import outcome_row, rows_hash
from tests.benchmarks.shared import TASKS, duration_s, play_suite, table

EPISODES, ROUNDS = 24, 2
SUITE = """
name: workers
policies: [untrained]
tasks: [{task}]
seeds: {{count: {episodes}}}
horizon: 40
render_profile: fast
workers: {workers}
"""


def measure() -> list[dict[str, object]]:
    """Episodes per hour from the first to the last, the better of two rounds each."""
    rows = []
    for task in TASKS:
        best, hashes = {1: 0.0, 2: 0.0}, set()
        for _ in range(ROUNDS):
            for workers in best:
                pace, digest = _run(task, workers)
                best[workers] = max(best[workers], pace)
                hashes.add(digest)
        rows.append({"task": task, "one": best[1], "two": best[2], "same_rows": len(hashes) == 1})
    table(
        ("task", "one worker, episodes/h", "two workers", "ratio", "same rows"),
        [
            (f["task"], f"{f['one']:,.0f}", f"{f['two']:,.0f}", f"{f['two'] / f['one']:.2f}", f["same_rows"])
            for f in rows
        ],
    )
    return rows


def _run(task: str, workers: int) -> tuple[float, str]:
    """Episodes per hour of a run, and its rows hash."""
    rows = play_suite(SUITE.format(task=task, episodes=EPISODES, workers=workers))
    return 3600 * len(rows) / duration_s(rows), rows_hash(map(outcome_row, rows))
