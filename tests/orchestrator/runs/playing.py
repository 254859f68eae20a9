"""Plays a suite without output, and reads rows from run folders."""

import io

from rich.console import Console

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store

SUITE = """
name: nulls
policies: [oracle, random]
tasks: [null/Reach]
seeds: {count: 20}
workers: 2
"""


def play(
    suite, folder, *, progress=Progress, out=None, part=None, on_numbers=lambda outcome: None, tracker=None, **options
):
    """Play the suite file into the folder, by default without media."""
    plan = make_plan(suite, part=part) if part else make_plan(suite)
    console = Console(file=out or io.StringIO(), force_terminal=False, width=200)
    return run_plan(plan, folder, RunOptions(**{"media": False, **options}), progress(console), on_numbers, tracker)


def rows_of(folder, url=None):
    """All rows of a run."""
    store = Store.open(url or f"sqlite:///{folder / 'episodes.sqlite'}", read_run(folder).run_id)
    rows = list(store.results())
    store.close()
    return rows


class Run:
    """Plays suites into a folder."""

    def __init__(self, folder):
        self.folder = folder
        self.output = io.StringIO()

    def __call__(self, suite, **options):
        return play(suite, self.folder, out=self.output, **options)

    def rows(self, store=None):
        return rows_of(self.folder, store)
