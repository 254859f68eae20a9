"""The schedule server, with real runs on the null simulator."""

import os
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from robogauntlet.orchestrator.schedules import server as server_module
from robogauntlet.orchestrator.schedules.run_process import RunProcess, conclude, has_ended, is_running, remove_old
from robogauntlet.orchestrator.schedules.schedule import CatchUp, Schedule, State
from robogauntlet.orchestrator.schedules.server import AlreadyRunning, Server, exclusive_server
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.folder_lock import lock_folder
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.run_history import History
from tests import ROOT
from tests.chaos.schedules import played, serve_and_kill
from tests.results.synthetic import document, run_folder

START = 1_795_000_000.0
SUITE = """
name: nights
policies: [{{name: mine, kind: {kind}}}]
tasks: [null/Reach]
seeds: {{count: {count}}}
workers: 1
"""


class Service:
    """Schedules, a clock that the test sets, the notifications and the log."""

    def __init__(self, folder):
        self.folder, self.root = folder, folder / "runs"
        self.root.mkdir()
        self.url = file_url(self.root / "history.sqlite")
        self.schedule_store, self.history = ScheduleStore.open(self.url), History.open(self.url)
        self.now, self.sent, self.log = START, [], []
        self.suite = folder / "nights.yaml"
        self.write()

    def write(self, kind="oracle", count=30):
        self.suite.write_text(SUITE.format(kind=kind, count=count))

    def add(self, name="nightly", **changes):
        values = {"cron": "*/2 * * * *", "arguments": ("--no-media",), "created_at": START, **changes}
        made = Schedule(name, str(self.suite), **values)
        self.schedule_store.add(made)
        return made

    def server(self, **options):
        options = {"send": self.sent.append, "log": self.log.append, "now": lambda: self.now, **options}
        return Server(self.schedule_store, self.history, self.root, **options)

    def settle(self, server, seconds=120.0):
        """Step the server until no run is due or running."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            server.step()
            open_states = (State.DUE, State.RUNNING)
            if not any(scheduled_run.state in open_states for scheduled_run in self.schedule_store.scheduled_runs()):
                return
            time.sleep(0.2)
        raise AssertionError(self.log)

    def trigger(self, schedule, number=0):
        return self.schedule_store.trigger_now(schedule, START + number, self.server().folder)

    def record(self, scheduled_run, number, **options):
        """Record a finished run of a scheduled run; return its document and folder."""
        run = document(4, run_id=f"run-{number}", started_at=START + number, name="nights")
        folder = run_folder(self.root / scheduled_run.folder, run, [])
        self.history.record(run, folder, **options)
        return run, folder

    def notified(self):
        return [message.title.partition(":")[0] for message in self.sent]

    def states(self):
        return [str(scheduled_run.state) for scheduled_run in self.schedule_store.scheduled_runs()[::-1]]


@pytest.fixture
def service(tmp_path):
    made = Service(tmp_path)
    yield made
    made.schedule_store.close()
    made.history.close()


@pytest.mark.ray
def test_worse_runs_are_flagged_and_no_others(service, ray_here):
    """A suite every two minutes. In the second run another policy has the name."""
    import ray

    address = ray.get_runtime_context().gcs_address
    service.add(arguments=("--no-media", "--address", address))
    server = service.server()
    for number in range(1, 4):
        service.write("oracle" if number % 2 else "random")
        service.now += 120
        service.settle(server)
    entries = service.history.runs()[::-1]
    assert service.states() == ["done"] * 3
    assert [entry.verdict for entry in entries] == [None, "regressed", "no evidence"]
    assert [entry.counts.rate for entry in entries] == [1.0, 0.0, 1.0]
    assert service.notified() == ["REGRESSED"]
    (message,) = service.sent
    assert message.run == entries[1].name
    assert "100 %" in message.lines[0]
    assert " 0 %" in message.lines[0]


@pytest.mark.slow
@pytest.mark.ray
def test_a_server_killed_at_any_moment_loses_and_doubles_no_run(service):
    """Four kills; `python -m tests.chaos.schedules` does a hundred."""
    service.write(count=40)
    schedule = service.add(cron="0 0 1 1 *")
    for number in range(2):
        service.trigger(schedule, number)
    serve_and_kill(service.url, kills=4, done=lambda: service.states() == ["done"] * 2)
    assert service.states() == ["done"] * 2
    folders = [scheduled_run.folder.rpartition("/")[2] for scheduled_run in service.schedule_store.scheduled_runs()]
    assert played(service.root, service.history) == dict.fromkeys(folders, 40)


@pytest.mark.ray
def test_missed_runs_are_caught_up_as_the_schedule_says(service):
    service.add("latest", catch_up=CatchUp.LATEST)
    service.add("skip", catch_up=CatchUp.SKIP)
    service.now = START + 2 * 3600 + 150  # the last was due 70 s ago
    server = service.server()
    server.step()
    server.stop()
    due = {name: [f.state for f in service.schedule_store.scheduled_runs(schedule=name)] for name in ("latest", "skip")}
    assert (due["latest"][0], set(due["latest"][1:])) == (State.RUNNING, {State.MISSED})
    assert set(due["skip"]) == {State.MISSED}
    assert service.notified() == ["MISSED", "MISSED"]
    assert f"MISSED: {len(due['skip'])} runs of skip" in [message.title for message in service.sent]


RECORDS_VIDEOS = """
import sys, time
from pathlib import Path
from robogauntlet.results.run_document import RunStatus
from tests.results.synthetic import document, run_folder
folder = Path(sys.argv[1])
ended = {"status": RunStatus.STOPPED, "reason": "a test", "finished_at": time.time() - 1.0}
run_folder(folder, document(4, run_id="run-1", name="nights", **ended), [])
(folder / "report.html").touch()
time.sleep(600)
"""


def test_a_continued_run_has_not_ended_before_its_report_is_renewed(tmp_path):
    run_folder(tmp_path, document(status=RunStatus.COMPLETE, finished_at=time.time() - 10.0), [])
    report = tmp_path / "report.html"
    report.touch()
    assert has_ended(tmp_path)
    os.utime(report, (time.time() - 20.0,) * 2)
    assert not has_ended(tmp_path)


@pytest.mark.parametrize("by_server", [True, False])
def test_a_run_is_concluded_before_its_videos_are_recorded(service, by_server, monkeypatch):
    def begin(schedule, scheduled_run, history_url):
        command = [sys.executable, "-c", RECORDS_VIDEOS, scheduled_run.folder]
        processes.append(subprocess.Popen(command, cwd=ROOT))
        return RunProcess(schedule, scheduled_run, processes[0])

    def send(message):
        service.sent.append(message)
        assert processes[0].poll() is None
        if not by_server:
            processes[0].terminate()

    processes = []
    monkeypatch.setattr("robogauntlet.orchestrator.schedules.server.begin", begin)
    schedule = service.add(cron="0 0 1 1 *")
    scheduled_run = service.trigger(schedule)
    server = service.server(send=send)
    if by_server:
        service.settle(server)
        service.trigger(schedule, 1)
        server.step()
        assert service.states() == ["failed", "due"]
        server.stop()
    else:
        server.play(schedule, scheduled_run)
        assert service.states() == ["failed"]
    assert processes[0].poll() is not None
    assert service.notified() == ["STOPPED"]


def test_a_schedule_that_fails_in_an_unforeseen_way_stops_no_other(service, monkeypatch):
    begun = []

    def begin(schedule, scheduled_run, history):
        if schedule.name == "broken":
            raise RecursionError("of a document")
        begun.append(schedule.name)
        raise KeyboardInterrupt

    monkeypatch.setattr(server_module, "begin", begin)
    other = service.folder / "other.yaml"
    other.write_text(service.suite.read_text())
    broken = service.add("broken")
    sound = replace(broken, name="sound", suite=str(other))
    service.schedule_store.add(sound)
    for schedule in (broken, sound):
        service.trigger(schedule)
    with pytest.raises(KeyboardInterrupt):
        service.server(max_parallel=2).step()
    assert begun == ["sound"]
    assert "broken: the run could not start: RecursionError: of a document" in service.log


def test_a_run_that_cannot_be_concluded_has_failed_and_is_not_tried_again(service, monkeypatch):
    def conclude(*_):
        raise RecursionError("of a document")

    monkeypatch.setattr(server_module, "conclude", conclude)
    monkeypatch.setattr(server_module, "has_ended", lambda folder: True)
    scheduled_run = service.trigger(service.add())
    service.schedule_store.change(scheduled_run, state=State.RUNNING)
    server = service.server()
    server.step()
    server.step()
    assert service.states() == ["failed"]
    assert service.log == ["nightly: the run could not be concluded: RecursionError: of a document"]


def test_two_runs_of_a_suite_never_overlap(service):
    one, other = service.add("one", cron="0 0 1 1 *"), service.add("other", cron="0 0 1 1 *")
    server = service.server(max_parallel=2)
    for schedule in (one, other):
        service.trigger(schedule)
    server.step()
    assert sorted(service.states()) == ["due", "running"]
    server.stop()


def test_a_new_server_waits_for_a_run_that_an_earlier_one_started(service):
    schedule = service.add(cron="0 0 1 1 *")
    scheduled_run = service.trigger(schedule)
    service.schedule_store.change(scheduled_run, state=State.RUNNING)
    with lock_folder(service.root / scheduled_run.folder, for_run=True):
        assert is_running(service.root / scheduled_run.folder)
        server = service.server()
        server.step()
        assert not server._processes
    assert not is_running(service.root / scheduled_run.folder)
    server.step()
    assert len(server._processes) == 1
    server.stop()


def test_a_missing_suite_file_fails_with_its_reason_and_a_notification(service):
    schedule = service.add(cron="0 0 1 1 *")
    service.suite.unlink()
    service.trigger(schedule)
    service.settle(service.server())
    (scheduled_run,) = service.schedule_store.scheduled_runs()
    assert scheduled_run.state is State.FAILED
    assert "nights.yaml" in scheduled_run.outcome
    assert service.notified() == ["STOPPED"]


def test_a_run_whose_baseline_is_gone_is_done_with_a_notification(service):
    schedule = service.add(cron="0 0 1 1 *")
    for number in range(2):
        scheduled_run = service.trigger(schedule, number)
        _, folder = service.record(scheduled_run, number)
        if number == 0:
            (folder / "episodes.sqlite").unlink()
    about = service.schedule_store, service.history, schedule, scheduled_run, 0, service.sent.append
    closed = conclude(*about)
    assert closed.state is State.DONE
    assert "not compared" in closed.outcome
    conclude(*about, "https://lab.example.org")
    assert service.notified() == ["NOT COMPARED"] * 2
    address = f"https://lab.example.org/runs/{closed.run_id}/files/report.html"
    assert [message.link for message in service.sent] == [str(folder / "report.html"), address]


def test_old_folders_are_removed_but_not_their_results_nor_the_baseline(service):
    schedule = service.add(keep=2)
    for number in range(5):
        scheduled_run = service.trigger(schedule, number)
        run, _ = service.record(scheduled_run, number, schedule="nightly")
        service.schedule_store.change(scheduled_run, state=State.DONE, run_id=run.run_id)
        if number > 1:
            service.history.write_verdict(run.run_id, "regressed", "run-1", ["worse"])
    removed = remove_old(service.schedule_store, service.history, schedule)
    kept = {path.parent.name for path in service.root.glob("*/run.json")}
    folders = [service.server().folder(schedule, START + number).rpartition("/")[2] for number in range(5)]
    assert kept == {folders[1], folders[3], folders[4]}
    assert sorted(path.name for path in removed) == [folders[0], folders[2]]
    assert len(service.history.runs()) == 5
    assert service.history.find("run-0").folder is None


def test_one_server_at_a_time_and_a_crash_releases_the_lock(service, tmp_path):
    code = (
        "import sys, time\nfrom pathlib import Path\n"
        "from robogauntlet.orchestrator.schedules.store import ScheduleStore\n"
        "from robogauntlet.orchestrator.schedules.server import exclusive_server\n"
        "store = ScheduleStore.open(sys.argv[1])\nwith exclusive_server(store.database, Path(sys.argv[2])):\n"
        "    print('here', flush=True)\n    time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, service.url, service.root], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"here\n"
    with (
        pytest.raises(AlreadyRunning, match="another schedule server runs on"),
        exclusive_server(service.schedule_store.database, service.root),
    ):
        pass
    process.kill()
    process.wait()
    process.stdout.close()
    with exclusive_server(service.schedule_store.database, service.root):
        pass
