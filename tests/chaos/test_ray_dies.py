"""The death of Ray itself at other times than while episodes of a run are played."""

import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator

import pytest

from robogauntlet.results.run_document import RunStatus, read_run
from tests import ROOT
from tests.chaos.processes import MARK, end, processes_by_kind, remaining_after
from tests.chaos.suites import NULL
from tests.processes import environment_of

pytestmark = [pytest.mark.ray, pytest.mark.chaos]

WAIT_S = 600.0
GONE_S = 60.0
GAUNTLET = "from robogauntlet.orchestrator.cli import main; main()"


class Command:
    """A running program, by default the `robogauntlet` command, and its log."""

    def __init__(self, log, *arguments, program=GAUNTLET):
        self.log, self.mark = log, uuid.uuid4().hex
        with log.open("w") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-c", program, *map(str, arguments)],
                env={**environment_of(ROOT), MARK: self.mark, "OMP_NUM_THREADS": "1"},
                stdout=out,
                stderr=subprocess.STDOUT,
            )

    def kill_raylet_when(self, condition):
        """Kill the raylet as soon as the condition holds."""
        deadline = time.monotonic() + WAIT_S
        while time.monotonic() < deadline and self.process.poll() is None:
            raylets = processes_by_kind(self.mark)["raylet"]
            if raylets and condition():
                raylets[0].send_signal(signal.SIGKILL)
                return
            time.sleep(0.05)
        raise AssertionError(f"the condition was never met: {self.log.read_text()}")

    def end(self):
        """Wait for its end; return its exit code and the processes that remain."""
        code = self.process.wait(WAIT_S)
        return code, remaining_after(self.mark, GONE_S)


@pytest.fixture
def start(tmp_path):
    commands = []

    def begin(*arguments, **options):
        commands.append(Command(tmp_path / f"{len(commands)}.log", *arguments, **options))
        return commands[-1]

    yield begin
    for command in commands:
        end(command.mark)


@pytest.fixture
def suite(tmp_path):
    file = tmp_path / "suite.yaml"
    file.write_text(NULL.replace("count: 120", "count: 40"))
    return file


def test_ray_is_restarted_while_media_are_recorded_and_no_video_is_missing(start, suite, tmp_path):
    suite.write_text(NULL.replace("count: 120", "count: 10"))
    folder = tmp_path / "run"
    command = start("run", suite, "--out", folder, "--media")
    command.kill_raylet_when(lambda: "videos and snapshots" in command.log.read_text())
    assert command.end() == (0, [])
    assert "it was started again" in command.log.read_text()
    document = read_run(folder)
    assert document.status is RunStatus.COMPLETE
    assert start("run", suite, "--out", tmp_path / "undisturbed", "--media").end() == (0, [])

    def videos(run):
        return {path.name for path in (run / "media").rglob("*") if path.is_file()}

    assert videos(folder) == videos(tmp_path / "undisturbed") != set()


def large() -> Iterator[bytes]:
    """Yield items that are too large for Ray to send without its object store."""
    while True:
        yield bytes(300_000)


LARGE = """
from robogauntlet.orchestrator.ray_runtime.simulator_processes import run_per_simulator
from robogauntlet.orchestrator.ray_runtime.session import RayLost, ray_session
from tests.chaos.test_ray_dies import large
try:
    with ray_session(address=None, workers=1):
        for _ in run_per_simulator(large, {"null": ()}):
            print("received", flush=True)
except RayLost as error:
    print(error)
"""


def test_the_death_of_ray_is_reported_while_large_results_arrive(start):
    """When the object store dies, Ray ends every process that reads from it."""
    program = start(program=LARGE)
    program.kill_raylet_when(lambda: program.log.read_text().count("received") > 20)
    assert program.end() == (0, [])
    assert "Ray's raylet died" in program.log.read_text()


def test_verify_reports_the_death_of_ray(start, suite, tmp_path):
    folder = tmp_path / "run"
    assert start("run", suite, "--out", folder, "--no-media").end() == (0, [])
    command = start("replay", "--verify", folder, "--sample", 160)
    command.kill_raylet_when(lambda: "null/Slow" in command.log.read_text())
    assert command.end() == (1, [])
    assert "died (exit status -9); verify again" in command.log.read_text()


def test_demonstrate_reports_the_death_of_ray_and_completes_when_repeated(start, tmp_path):
    folder = tmp_path / "data"
    arguments = ("new", "demonstrations", "null/Slow", "--episodes", 300, "--out", folder)
    command = start(*arguments)
    command.kill_raylet_when(lambda: any(folder.rglob("*.parquet")) or "null/Slow: " in command.log.read_text())
    assert command.end() == (3, [])
    assert "died (exit status -9)" in command.log.read_text()
    assert start(*arguments).end() == (0, [])
