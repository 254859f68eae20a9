"""The live status and the result of a run in the history."""

import threading
import time
from functools import partial

import pytest

from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.run_history import History
from tests.orchestrator.runs.playing import play as play_suite

SUITE = "name: nights\npolicies: [oracle]\ntasks: [null/Slow]\nseeds: {count: 30}\nworkers: 1\n"


@pytest.fixture
def play(tmp_path, ray_here):
    (tmp_path / "nights.yaml").write_text(SUITE)

    return partial(play_suite, tmp_path / "nights.yaml", tmp_path / "run")


@pytest.mark.ray
def test_a_run_writes_its_live_status_and_at_its_end_its_result(play, tmp_path):
    history, heard, over = History.open(file_url(tmp_path / "history.sqlite")), [], threading.Event()

    def listen():
        while not over.wait(0.1):
            heard.extend(entry.live for entry in history.runs(status="running") if entry.live)

    listener = threading.Thread(target=listen)
    listener.start()
    outcome = play(history=history.url, schedule="nightly")
    over.set()
    listener.join()
    last = heard[-1]
    assert last.phase == "playing"
    assert 0 < max(live.simulators[0].done for live in heard) <= 30
    assert {worker.simulator for live in heard for worker in live.workers} == {"null"}
    doing = {worker.activity.partition(", clean")[0] for live in heard for worker in live.workers}
    assert "oracle on null/Slow" in doing
    assert all(worker.since <= time.time() for worker in last.workers)
    (entry,) = history.runs()
    assert (entry.status, entry.schedule, entry.live, entry.name) == ("complete", "nightly", None, "run")
    assert (entry.counts.done, entry.counts.planned) == (30, 30)
    assert history.document(entry.run_id) == outcome.document
    history.close()


@pytest.mark.ray
def test_a_history_that_cannot_be_opened_is_a_warning_and_the_run_goes_on(play, tmp_path):
    (tmp_path / "history.sqlite").write_text("this is no database, but a text that is long enough to be looked at")
    outcome = play(history=file_url(tmp_path / "history.sqlite"))
    assert outcome.document.status == "complete"
    assert [trouble.partition(":")[0] for trouble in outcome.warnings] == ["this run is not recorded in the history"]


@pytest.mark.ray
def test_the_store_with_the_rows_has_an_entry_of_the_run(play, tmp_path):
    outcome = play()
    history = History.open(file_url(tmp_path / "run" / "episodes.sqlite"))
    (entry,) = history.runs()
    assert (entry.run_id, entry.counts.successes) == (outcome.document.run_id, outcome.done)
    history.close()
