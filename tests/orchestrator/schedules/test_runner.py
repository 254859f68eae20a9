"""Runs of schedules, with real runs on the null simulator."""

import subprocess
import sys
import time

import pytest

from robogauntlet.orchestrator.schedules import runner as runner_module
from robogauntlet.orchestrator.schedules.runner import AlreadyRunning, Runner, remove_old
from robogauntlet.orchestrator.schedules.schedule import Schedule
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.folder_lock import lock_folder
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.database import StoreError, file_url
from robogauntlet.results.store.run_history import History
from robogauntlet.support.files import exclusive
from tests.results.synthetic import document, run_folder

START = 1_795_000_000.0
SUITE = """
name: nights
policies: [{{name: mine, kind: {kind}}}]
tasks: [null/Reach]
seeds: {{count: {count}}}
workers: 1
"""


class Stop(Exception):
    """Ends a server."""


class Service:
    """A runner, a suite, the notifications and the log."""

    def __init__(self, folder):
        self.folder, self.root = folder, folder / "runs"
        self.root.mkdir()
        url = file_url(self.root / "history.sqlite")
        self.store, self.history = ScheduleStore.open(url), History.open(url)
        self.sent, self.log = [], []
        self.suite = folder / "nights.yaml"
        self.write()
        self.runner = Runner(self.store, self.history, self.root, self.sent.append, self.log.append)

    def write(self, kind="oracle", count=30):
        self.suite.write_text(SUITE.format(kind=kind, count=count))

    def schedule(self, name="nightly", **values):
        return Schedule(**{"name": name, "suite": str(self.suite), "cron": "* * * * *"} | values)

    def notified(self):
        return [message.title.partition(":")[0] for message in self.sent]


@pytest.fixture
def service(tmp_path):
    made = Service(tmp_path)
    yield made
    made.store.close()
    made.history.close()


@pytest.fixture
def quick(monkeypatch):
    """Processes that end at once in place of runs; gives their schedules and folders."""
    begun = []

    def begin(schedule, folder, url):
        folder.mkdir()
        begun.append((schedule.name, folder))
        return subprocess.Popen([sys.executable, "-c", "raise SystemExit(2)"])

    monkeypatch.setattr(runner_module, "begin", begin)
    monkeypatch.setattr(runner_module, "POLL_S", 0.01)
    return begun


@pytest.mark.ray
def test_a_worse_run_is_flagged_and_the_first_is_not(service, ray_here):
    """In the second run another policy has the name."""
    import ray

    address = ray.get_runtime_context().gcs_address
    schedule = service.schedule(arguments=["--no-media", "--address", address])
    outcomes = []
    for number in range(2):
        service.write("random" if number == 1 else "oracle")
        outcomes.append(service.runner.play(schedule))
        time.sleep(1.0)  # so that the next folder has another name
    entries = service.history.runs()[::-1]
    assert [outcome.is_good for outcome in outcomes] == [True, False], [outcome.text for outcome in outcomes]
    assert [outcome.run_id for outcome in outcomes] == [entry.run_id for entry in entries]
    assert [entry.verdict for entry in entries] == [None, "regressed"]
    assert [entry.counts.rate for entry in entries] == [1.0, 0.0]
    assert [entry.schedule for entry in entries] == ["nightly"] * 2
    assert service.notified() == ["REGRESSED"]
    (message,) = service.sent
    assert message.run == entries[1].name
    assert "100 %" in message.lines[0]
    (stored,) = service.store.schedules()
    assert (stored.outcome, stored.run_id) == (outcomes[1].text, entries[1].run_id)


def test_a_server_runs_what_becomes_due_once_and_says_what_is_next(service, quick, monkeypatch):
    clock = [START - START % 60 + 30.0]  # half a minute before the next time
    waited = []

    def sleep(seconds):
        waited.append([schedule.next_due_at for schedule in service.store.schedules()])
        clock[0] += 20.0
        if len(waited) == 8:
            raise Stop

    monkeypatch.setattr(runner_module, "time", lambda: clock[0])
    monkeypatch.setattr(runner_module, "sleep", sleep)
    with pytest.raises(Stop):
        service.runner.serve([service.schedule(), service.schedule("other", cron="@yearly")])
    assert [name for name, _ in quick] == ["nightly"] * 2
    minute = START - START % 60 + 60.0
    assert waited[0][0] == minute
    assert waited[2][0] == minute + 60.0


def test_what_becomes_due_twice_during_another_run_is_run_once(service, quick, monkeypatch):
    now = [START]
    monkeypatch.setattr(runner_module, "time", lambda: now[0])
    looked_at = {"nightly": START}
    now[0] += 3600.0
    service.runner._step([service.schedule()], looked_at)
    service.runner._step([service.schedule()], looked_at)
    assert len(quick) == 1


def test_a_schedule_goes_on_after_a_clock_that_was_ahead(service, quick, monkeypatch):
    now = [START + 1e6]
    monkeypatch.setattr(runner_module, "time", lambda: now[0])
    looked_at = {"nightly": START + 1e6}
    now[0] = START
    service.runner._step([service.schedule()], looked_at)
    now[0] += 60.0
    service.runner._step([service.schedule()], looked_at)
    assert len(quick) == 1


def test_a_schedule_that_fails_in_an_unforeseen_way_stops_no_other(service, quick, monkeypatch):
    begin = runner_module.begin

    def fail(schedule, folder, url):
        if schedule.name == "broken":
            raise RecursionError("of a document")
        return begin(schedule, folder, url)

    monkeypatch.setattr(runner_module, "begin", fail)
    schedules = [service.schedule("broken"), service.schedule("sound")]
    service.runner._step(schedules, {"broken": 0.0, "sound": 0.0})
    assert [name for name, _ in quick] == ["sound"]
    assert "broken: RecursionError: of a document" in service.log


def test_a_server_goes_on_when_the_store_is_back(service, quick, monkeypatch):
    failures = iter([StoreError("the disk is full"), None, Stop()])

    def write(schedule, **values):
        if (error := next(failures)) is not None:
            raise error

    monkeypatch.setattr(service.store, "write", write)
    with pytest.raises(Stop):
        service.runner.serve([service.schedule(cron="@yearly")])
    assert service.log == ["the schedules cannot be stored: the disk is full; trying again"]


def test_a_server_that_is_stopped_stops_its_run(service, quick, monkeypatch):
    begun = []

    def begin(schedule, folder, url):
        begun.append(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]))
        return begun[0]

    def meanwhile():
        raise KeyboardInterrupt

    monkeypatch.setattr(runner_module, "begin", begin)
    with pytest.raises(KeyboardInterrupt):
        service.runner.play(service.schedule(), meanwhile)
    assert begun[0].poll() is not None


def test_two_runs_of_a_schedule_never_overlap_and_one_process_serves(service, quick):
    with (
        exclusive(service.root / ".nightly.lock", AssertionError()),
        pytest.raises(AlreadyRunning, match="nightly: its last run is in progress"),
    ):
        service.runner.play(service.schedule())
    with (
        exclusive(service.root / ".schedules.lock", AssertionError()),
        pytest.raises(AlreadyRunning, match="another process serves the schedules of"),
    ):
        service.runner.serve([service.schedule()])
    assert quick == []


def test_a_missing_suite_file_fails_with_its_reason_and_a_notification(service):
    service.suite.unlink()
    outcome = service.runner.play(service.schedule())
    assert not outcome.is_good
    assert "nights.yaml" in outcome.text
    assert service.notified() == ["STOPPED"]


@pytest.mark.parametrize("public", [None, "https://lab.example.org"])
def test_a_run_whose_baseline_is_gone_is_said_with_a_link(service, public):
    for number in range(2):
        run = document(4, run_id=f"run-{number}", started_at=START + number, name="nights")
        folder = run_folder(service.root / f"nightly-{number}", run, [])
        service.history.record(run, folder)
        if number == 0:
            (folder / "episodes.sqlite").unlink()
    places = service.store, service.history, service.root, service.sent.append, service.log.append
    outcome = Runner(*places, public).conclude(service.schedule(), folder, 0)
    assert "not compared" in outcome.text
    assert service.notified() == ["NOT COMPARED"]
    link = str(folder / "report.html") if public is None else f"{public}/runs/run-1/files/report.html"
    assert service.sent[0].link == link


def test_a_run_that_stopped_early_is_said(service):
    run = document(4, run_id="run-1", name="nights", status=RunStatus.STOPPED, reason="too many errors")
    outcome = service.runner.conclude(service.schedule(), run_folder(service.root / "nightly-1", run, []), 1)
    assert outcome.text == "stopped: too many errors"
    assert not outcome.is_good
    assert service.notified() == ["STOPPED"]


def test_old_folders_are_removed_but_not_their_results_nor_the_baseline(service):
    for number in range(5):
        run = document(4, run_id=f"run-{number}", started_at=START + number, name="nights")
        folder = run_folder(service.root / f"nightly-{number}", run, [])
        service.history.record(run, folder, schedule="nightly")
        if number > 1:
            service.history.write_verdict(run.run_id, "regressed", "run-1", ["worse"])
    with lock_folder(service.root / "nightly-2", for_run=True):
        removed = remove_old(service.history, service.schedule(keep=2))
    assert [path.name for path in removed] == ["nightly-0"]
    removed = remove_old(service.history, service.schedule(keep=2))
    assert [path.name for path in removed] == ["nightly-2"]
    kept = {path.parent.name for path in service.root.glob("*/run.json")}
    assert kept == {"nightly-1", "nightly-3", "nightly-4"}
    assert len(service.history.runs()) == 5
    assert service.history.find("run-0").folder is None
