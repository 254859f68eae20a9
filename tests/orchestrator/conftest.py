"""A local Ray for the tests that need one, an observer of a scheduler, and the command line in this process."""

import contextlib
import os
import sys
from dataclasses import dataclass

import pytest

from tests import ROOT


@pytest.fixture(scope="session")
def ray_here():
    from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
    from robogauntlet.orchestrator.ray_runtime.session import RayLost, ray_session

    variables = EnvironmentResolver().shared_variables(["null"])  # which its workers then need not set up
    with contextlib.ExitStack() as stack:
        with pytest.MonkeyPatch.context() as patch:  # workers import functions of tests
            patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])))
            for last in (False, False, True):  # on a busy machine, Ray's own 30 s to start may not be enough
                try:
                    stack.enter_context(ray_session(address=None, workers=3, variables=variables))
                    break
                except RayLost:
                    if last:
                        raise
        yield


@pytest.fixture(scope="module")
def room_for_one():
    """Runs whose suite names no number of workers have one: each costs seconds of processor time to start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robogauntlet.orchestrator.runs.run.room_for_workers", lambda: 1)
        yield


class RecordingObserver:
    """An observer of a scheduler that records its calls."""

    def __init__(self):
        self.ready, self.skipped, self.rows, self.warnings = [], [], [], []
        self.on_ready = lambda readiness: None
        self.on_rows = lambda rows: None

    def on_started(self, simulator, readiness):
        self.ready.append((simulator, readiness))
        self.on_ready(readiness)

    def on_skipped(self, simulator, reason, episodes):
        self.skipped.append((simulator, reason, episodes))

    def on_results(self, results):
        self.rows += results
        self.on_rows(results)

    def on_warning(self, message):
        self.warnings.append(message)

    def on_tick(self, activity):
        pass


@pytest.fixture
def observer():
    return RecordingObserver()


@dataclass(frozen=True)
class CommandResult:
    code: int
    out: str
    err: str

    @property
    def refusal(self):
        """The only line of a command that refused its input."""
        assert self.code == 2, self.out + self.err
        (line,) = self.err.splitlines()
        return line.removeprefix("robogauntlet: ")


@pytest.fixture
def run_command(monkeypatch, capsys, tmp_path):
    """Runs `robogauntlet ...` in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("ROBOGAUNTLET_HISTORY", "ROBOGAUNTLET_STORE"):
        monkeypatch.delenv(name, raising=False)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["robogauntlet", *map(str, arguments)])
        capsys.readouterr()
        try:
            from robogauntlet.orchestrator.cli import main

            main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        printed = capsys.readouterr()
        assert "Traceback" not in printed.out + printed.err
        return CommandResult(code, printed.out, printed.err)

    return call
