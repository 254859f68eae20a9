"""Plays a suite without output, and reads rows from run folders."""

import io
from pathlib import Path

from rich.console import Console

from robogauntlet.orchestrator.runs.history_observer import HistoryObserver
from robogauntlet.orchestrator.runs.observer import Observer, RunState
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.orchestrator.runs.run_progress import RunProgress
from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store
from tests.results.synthetic import document

SUITE = """
name: nulls
policies: [oracle, random]
tasks: [null/Reach]
seeds: {count: 20}
workers: 1
"""


def play(suite, folder, *, out=None, part=None, observers=(), history=None, **options):
    """Play the suite file into the folder, by default without media."""
    plan = make_plan(suite, part=part) if part else make_plan(suite)
    display = ProgressDisplay(Console(file=out or io.StringIO(), force_terminal=False, width=200))
    recorded = [] if history is None else [HistoryObserver(history, folder, options.get("schedule"))]
    return run_plan(plan, folder, RunOptions(**{"media": False, **options}), [display, *recorded, *observers])


def state_of(plan, stored=None):
    """A run of a plan that nothing is stored of, or these counts of its cells."""
    planned = document(plan.suite.seeds.count, plan.cells)
    return RunState(plan, planned, Path("runs/nulls"), None, RunProgress(plan, stored or {}))


def observer(**hooks):
    """An observer with these hooks."""
    found = Observer()
    for name, hook in hooks.items():
        setattr(found, name, hook)
    return found


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
