"""Promises of the server of the calendar, with real runs on the null simulator."""

import subprocess
import sys
import time

import pytest

from robogauntlet.orchestrator.schedules.run_process import conclude, is_running
from robogauntlet.orchestrator.schedules.schedule import CatchUp, Schedule, State
from robogauntlet.orchestrator.schedules.server import AlreadyRunning, Server, exclusive_server
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.folder_lock import lock_folder
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.run_history import History
from tests.chaos.schedules import played, serve_and_kill
from tests.results.synthetic import document, run_folder

START = 1_795_000_000.0
SUITE = "name: nights\npolicies: [{{name: mine, kind: {kind}}}]\ntasks: [null/Reach]\nseeds: {{count: {count}}}\n"


class World:
    """A calendar, a clock that is turned by hand, and what people were told."""

    def __init__(self, folder):
        self.folder, self.root = folder, folder / "runs"
        self.root.mkdir()
        self.url = file_url(self.root / "history.sqlite")
        self.schedule_store, self.history = ScheduleStore.open(self.url), History.open(self.url)
        self.now, self.told, self.log = START, [], []
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
        return Server(
            self.schedule_store,
            self.history,
            self.root,
            send=self.told.append,
            log=self.log.append,
            now=lambda: self.now,
            **options,
        )

    def settle(self, server, seconds=120.0):
        """Let the server do what there is to do."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            server.step()
            open_states = (State.DUE, State.RUNNING)
            if not any(scheduled_run.state in open_states for scheduled_run in self.schedule_store.scheduled_runs()):
                return
            time.sleep(0.05)
        raise AssertionError(self.log)

    def states(self):
        return [str(scheduled_run.state) for scheduled_run in self.schedule_store.scheduled_runs()[::-1]]


@pytest.fixture
def world(tmp_path):
    made = World(tmp_path)
    yield made
    made.schedule_store.close()
    made.history.close()


@pytest.mark.slow
@pytest.mark.ray
def test_of_ten_runs_the_two_that_are_worse_are_flagged_and_no_other(world):
    """A suite every two minutes; in the fourth and the eighth run the policy is another."""
    world.add()
    server = world.server()
    for number in range(1, 11):
        world.write("random" if number in (4, 8) else "oracle")
        world.now += 120
        world.settle(server)
    entries = world.history.runs()[::-1]
    assert world.states() == ["done"] * 10
    assert [entry.verdict == "regressed" for entry in entries] == [n in (4, 8) for n in range(1, 11)]
    assert [entry.verdict for entry in entries[1:3]] == ["no evidence"] * 2
    assert [entry.counts.rate for entry in entries] == [0.0 if n in (4, 8) else 1.0 for n in range(1, 11)]
    assert [message.title.partition(":")[0] for message in world.told] == ["REGRESSED"] * 2
    assert {message.run for message in world.told} == {entries[3].name, entries[7].name}
    assert all("100 %" in message.lines[0] and "0 %" in message.lines[0] for message in world.told)


@pytest.mark.slow
@pytest.mark.ray
def test_killed_at_any_moment_it_loses_no_run_and_doubles_none(world):
    """A dozen kills; `python -m tests.chaos.schedules` does a hundred."""
    world.write(count=40)
    schedule = world.add(cron="0 0 1 1 *")
    for number in range(2):
        world.schedule_store.trigger_now(schedule, START + number, world.server().folder)
    serve_and_kill(world.url, kills=12, done=lambda: world.states() == ["done"] * 2)
    assert world.states() == ["done"] * 2
    assert played(world.root, world.history) == {
        scheduled_run.folder.rpartition("/")[2]: 40 for scheduled_run in world.schedule_store.scheduled_runs()
    }


@pytest.mark.ray
def test_what_was_missed_is_caught_up_as_the_schedule_says(world):
    world.add("latest", catch_up=CatchUp.LATEST)
    world.add("skip", catch_up=CatchUp.SKIP)
    world.now = START + 2 * 3600 + 150  # the last was due 70 s ago
    server = world.server()
    server.step()
    server.stop()
    due = {name: [f.state for f in world.schedule_store.scheduled_runs(schedule=name)] for name in ("latest", "skip")}
    assert (due["latest"][0], set(due["latest"][1:])) == (State.RUNNING, {State.MISSED})
    assert set(due["skip"]) == {State.MISSED}
    assert [message.title.partition(":")[0] for message in world.told] == ["MISSED", "MISSED"]
    assert f"MISSED: {len(due['skip'])} runs of skip" in [message.title for message in world.told]


def test_two_runs_of_a_suite_never_overlap(world):
    one, other = world.add("one", cron="0 0 1 1 *"), world.add("other", cron="0 0 1 1 *")
    server = world.server(max_parallel=2)
    for schedule in (one, other):
        world.schedule_store.trigger_now(schedule, START, server.folder)
    server.step()
    assert sorted(world.states()) == ["due", "running"]
    server.stop()


def test_a_run_that_goes_on_without_its_server_is_waited_for(world):
    schedule = world.add(cron="0 0 1 1 *")
    scheduled_run = world.schedule_store.trigger_now(schedule, START, world.server().folder)
    world.schedule_store.change(scheduled_run, state=State.RUNNING)
    with lock_folder(world.root / scheduled_run.folder, for_run=True):
        assert is_running(world.root / scheduled_run.folder)
        server = world.server()
        server.step()
        assert not server._processes
    assert not is_running(world.root / scheduled_run.folder)
    server.step()
    assert len(server._processes) == 1
    server.stop()


def test_a_suite_that_is_gone_fails_with_its_reason_and_people_are_told(world):
    schedule = world.add(cron="0 0 1 1 *")
    world.suite.unlink()
    world.schedule_store.trigger_now(schedule, START, world.server().folder)
    world.settle(world.server())
    (scheduled_run,) = world.schedule_store.scheduled_runs()
    assert scheduled_run.state is State.FAILED
    assert "nights.yaml" in scheduled_run.outcome
    assert [message.title.partition(":")[0] for message in world.told] == ["STOPPED"]


def test_a_run_whose_baseline_is_gone_is_done_and_people_are_told(world):
    schedule = world.add(cron="0 0 1 1 *")
    for number in range(2):
        scheduled_run = world.schedule_store.trigger_now(schedule, START + number, world.server().folder)
        run = document(4, run_id=f"run-{number}", started_at=START + number, name="nights")
        folder = run_folder(world.root / scheduled_run.folder, run, [])
        world.history.record(run, folder)
        if number == 0:
            (folder / "episodes.sqlite").unlink()
    closed = conclude(world.schedule_store, world.history, schedule, scheduled_run, 0, world.told.append)
    assert closed.state is State.DONE
    assert "not compared" in closed.outcome
    assert [message.title.partition(":")[0] for message in world.told] == ["NOT COMPARED"]


def test_old_folders_are_removed_but_not_their_numbers_nor_the_baseline(world):
    from robogauntlet.orchestrator.schedules.run_process import remove_old

    schedule = world.add(keep=2)
    for number in range(5):
        scheduled_run = world.schedule_store.trigger_now(schedule, START + number, world.server().folder)
        run = document(4, run_id=f"run-{number}", started_at=START + number, name="nights")
        folder = run_folder(world.root / scheduled_run.folder, run, [])
        world.history.record(run, folder, schedule="nightly")
        world.schedule_store.change(scheduled_run, state=State.DONE, run_id=run.run_id)
        if number > 1:
            world.history.write_verdict(run.run_id, "regressed", "run-1", ["worse"])
    removed = remove_old(world.schedule_store, world.history, schedule)
    kept = {path.parent.name for path in world.root.glob("*/run.json")}
    folders = [world.server().folder(schedule, START + number).rpartition("/")[2] for number in range(5)]
    assert kept == {folders[1], folders[3], folders[4]}
    assert sorted(path.name for path in removed) == [folders[0], folders[2]]
    assert len(world.history.runs()) == 5
    assert world.history.find("run-0").folder is None


def test_a_calendar_is_served_by_one_process_and_a_crash_frees_it(world, tmp_path):
    code = (
        "import sys, time\nfrom pathlib import Path\n"
        "from robogauntlet.orchestrator.schedules.store import ScheduleStore\n"
        "from robogauntlet.orchestrator.schedules.server import exclusive_server\n"
        "store = ScheduleStore.open(sys.argv[1])\nwith exclusive_server(store.database, Path(sys.argv[2])):\n"
        "    print('here', flush=True)\n    time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, world.url, world.root], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"here\n"
    with (
        pytest.raises(AlreadyRunning, match="another schedule server runs on"),
        exclusive_server(world.schedule_store.database, world.root),
    ):
        pass
    process.kill()
    process.wait()
    process.stdout.close()
    with exclusive_server(world.schedule_store.database, world.root):
        pass
