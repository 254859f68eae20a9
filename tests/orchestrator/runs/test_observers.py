"""What the observers of a run are told, and what a run does with their trouble."""

import pytest

from robogauntlet.orchestrator.episodes.lease import Readiness
from robogauntlet.orchestrator.runs.observer import Observer
from robogauntlet.orchestrator.runs.observers import Observers
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.results.store.database import StoreError
from tests.orchestrator.runs.playing import SUITE, observer, state_of
from tests.results.synthetic import row

HOOKS = [name for name in vars(Observer) if name.startswith("on_")]


@pytest.fixture
def run(suite_file):
    return state_of(make_plan(suite_file(SUITE)))


class Recorder:
    """Records the names of its hooks that are called, and lines and warnings."""

    def __init__(self):
        self.heard = []

    def __getattr__(self, name):
        return lambda *told: self.heard.append((name, *(one for one in told if isinstance(one, str))))


def tell_all(observers, run):
    """A whole run."""
    observers.start()
    observers.on_started("null", Readiness(1, "CPU", 0.012))
    observers.on_results([row(run.plan.cells[0], 0)])
    observers.on_tick()
    observers.on_skipped("null", "no room", 3)
    observers.on_numbers()
    observers.on_end()


def test_observers_are_told_everything_in_order(run):
    recorder = Recorder()
    with Observers([recorder], run) as observers:
        tell_all(observers, run)
    assert recorder.heard == [
        ("on_start",),
        ("on_line", "null: ready (renders on CPU, 12 ms per observation)"),
        ("on_rows",),
        ("on_tick",),
        ("on_warning", "null is skipped (3 episodes): no room"),
        ("on_numbers",),
        ("on_end",),
        ("close",),
    ]
    assert (run.skipped, run.render_devices) == ({"null": "no room"}, {"null": "CPU"})
    assert run.live().simulators[0].done == 1


@pytest.mark.parametrize("hook", HOOKS)
def test_an_observer_that_raises_costs_one_warning_and_is_told_nothing_more(run, hook):
    def fail(*told):
        raise StoreError("the history is gone")

    recorder, broken = Recorder(), Recorder()
    setattr(broken, hook, fail)
    with Observers([broken, recorder], run) as observers:
        tell_all(observers, run)
    assert [warning for warning in run.warnings if "skipped" not in warning] == ["the history is gone"]
    assert broken.heard[-1] == ("close",)
    assert broken.heard.count(("close",)) == 1
    assert {name for name, *_ in recorder.heard} == {*HOOKS, "close"}


def test_an_exception_that_nobody_expects_is_named_with_its_observer(run):
    with Observers([observer(on_tick=lambda run: {}["x"])], run) as observers:
        observers.on_tick()
    assert run.warnings == ["Observer: KeyError: 'x'"]


def interrupt(run):
    raise KeyboardInterrupt


def test_an_interruption_ends_the_run_while_it_plays_and_only_the_observer_at_its_end(run):
    recorder = Recorder()
    with Observers([observer(on_tick=interrupt, on_end=interrupt), recorder], run) as observers:
        with pytest.raises(KeyboardInterrupt):
            observers.on_tick()
        observers.on_end()
    assert run.warnings == ["Observer was interrupted"]
    assert recorder.heard == [("on_end",), ("close",)]


def test_observers_are_closed_when_a_run_breaks(run):
    recorder = Recorder()
    with pytest.raises(RuntimeError), Observers([recorder], run):
        raise RuntimeError
    assert recorder.heard == [("close",)]
