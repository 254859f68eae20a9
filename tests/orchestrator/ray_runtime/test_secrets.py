"""Where a policy of others runs, there are none of the user's secrets."""

import sys
import time

import psutil
import pytest

from robogauntlet.orchestrator.schedules.run_process import LOG_FILE, begin
from robogauntlet.orchestrator.schedules.schedule import SCHEDULE_VARIABLE, Schedule, ScheduledRun, State
from robogauntlet.results.store.database import file_url
from robogauntlet.support.child_process import JsonChild
from robogauntlet.support.secret_variables import POLICY_TOKEN, RUN_SECRETS, SECRETS, SERVER_SECRETS, without_secrets

POLICY = """
import os
import pathlib

def look(images, proprioception, instruction):
    seen = repr(dict(os.environ)) + pathlib.Path("/proc/self/environ").read_text()
    pathlib.Path(os.environ["SEEN"]).write_text(seen)
    return [[0.0] * 7]
"""
ENVIRON = "from robogauntlet.support.child_process import serve\nimport os\nserve(lambda _: dict(os.environ))"


@pytest.fixture
def secrets(monkeypatch):
    """Secrets in this process's environment, but for the URLs of databases."""
    urls = {"ROBOGAUNTLET_STORE", "ROBOGAUNTLET_HISTORY"}
    values = {name: f"geheim-{name}" for name in (*SECRETS, POLICY_TOKEN, f"{POLICY_TOKEN}_B") if name not in urls}
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    return values


def test_a_child_process_gets_no_secret(secrets):
    with JsonChild([sys.executable, "-c", ENVIRON]) as child:
        seen = child.ask(None, 20.0)
    assert "PATH" in seen
    assert not any("geheim" in value for value in seen.values())


def test_other_variables_stay():
    assert without_secrets({"PATH": "x", "ROBOGAUNTLET_TOKENS": "y", POLICY_TOKEN: "z"}) == {
        "PATH": "x",
        "ROBOGAUNTLET_TOKENS": "y",
    }


@pytest.mark.ray
@pytest.mark.parametrize("inference", ["worker", "served"])
def test_a_scheduled_run_and_its_workers_have_only_what_they_need(secrets, tmp_path, monkeypatch, inference):
    (tmp_path / "looking.py").write_text(POLICY)
    options = f"{{callable: 'looking:look', folder: {tmp_path}}}"
    (tmp_path / "suite.yaml").write_text(
        f"name: s\npolicies: [{{name: p, kind: python, options: {options}}}]\ntasks: [null/Reach]\nhorizon: 4\n"
        f"seeds: {{count: 1}}\nworkers: 1\ninference: {{place: {inference}}}\n"
    )
    monkeypatch.setenv("SEEN", str(tmp_path / "seen"))
    schedule = Schedule("nightly", str(tmp_path / "suite.yaml"), cron="@daily", arguments=("--no-media",))
    run = ScheduledRun("nightly", 0.0, State.DUE, str(tmp_path / "run"))
    begun = begin(schedule, run, file_url(tmp_path / "history.sqlite"))
    try:
        while SCHEDULE_VARIABLE not in (its := psutil.Process(begun.process.pid).environ()):
            time.sleep(0.01)  # until the new process has replaced the copy of this one
        assert begun.process.wait(120) == 0, (tmp_path / "run" / LOG_FILE).read_text()
    finally:
        begun.process.kill()
    assert not set(SERVER_SECRETS) & set(its)
    assert {name for name in RUN_SECRETS if "geheim" in its.get(name, "")} == set(RUN_SECRETS) & set(secrets)
    seen = (tmp_path / "seen").read_text()
    assert [name for name, value in secrets.items() if value in seen and not name.startswith(POLICY_TOKEN)] == []
    assert "history.sqlite" not in seen
