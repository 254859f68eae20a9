"""The same episodes of the same policy with one worker and with two, alternating."""

from robogauntlet.results.record import outcome_row, rows_hash
from studies.percent import few
from studies.shared import TASKS, duration_s, play_suite, table_of

EPISODES, ROUNDS = 24, few(2, 1)
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
    for task in TASKS[: few(len(TASKS), 1)]:
        best, hashes = {1: 0.0, 2: 0.0}, set()
        for _ in range(ROUNDS):
            for workers in best:
                pace, digest = _run(task, workers)
                best[workers] = max(best[workers], pace)
                hashes.add(digest)
        ratio, same = best[2] / best[1], len(hashes) == 1
        rows.append({"task": task, "one": best[1], "two": best[2], "ratio": ratio, "same_rows": same})
    columns = {"task": "{task}", "one worker, episodes/h": "{one:,.0f}", "two workers": "{two:,.0f}"}
    table_of(rows, columns | {"ratio": "{ratio:.2f}", "same rows": "{same_rows}"})
    return rows


def _run(task: str, workers: int) -> tuple[float, str]:
    """Episodes per hour of a run, and its rows hash."""
    rows = play_suite(SUITE.format(task=task, episodes=EPISODES, workers=workers))
    return 3600 * len(rows) / duration_s(rows), rows_hash(map(outcome_row, rows))
