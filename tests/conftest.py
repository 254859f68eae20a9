"""Fixtures that all tests share."""

import gc
import os
import signal
import tempfile
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator import kit
from tests.jobs import JOBS
from tests.orchestrator.conftest import run_command  # noqa: F401

# The duration of an example depends on the load of the machine, not on the code.
settings.register_profile(
    "whatever the time", deadline=None, max_examples=int(os.environ.get("ROBOGAUNTLET_EXAMPLES", "40"))
)
settings.load_profile("whatever the time")

# Tables are as wide as their content, in any terminal or process.
os.environ["COLUMNS"] = "200"

# Tests that are started in the background ignore Ctrl-C, and so would the commands that they start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What a person has configured for their own runs is no part of the tests.
os.environ["ROBOGAUNTLET_CONFIG"] = os.devnull
_ENVIRONMENTS = tempfile.TemporaryDirectory(prefix="robogauntlet-environments-")
os.environ["ROBOGAUNTLET_ENVIRONMENTS"] = _ENVIRONMENTS.name
_STATE = tempfile.TemporaryDirectory(prefix="robogauntlet-state-")
os.environ["XDG_STATE_HOME"] = _STATE.name

# Tests open several simulators in one process, so the variables of all are set before the first is imported.
for _simulator in catalog.simulators().values():
    for _name, _value in _simulator.environment.items():
        os.environ.setdefault(_name, _value)
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_addoption(parser):
    parser.addoption(
        "--whole", action="store_true", help="fail if tests are skipped, except for what a machine cannot do"
    )
    parser.addoption("--job", choices=JOBS, help="only the tests of a job that `make test` leaves out")


def lacking_skips(skipped):
    """Reasons of skipped tests, and their number, that do not begin with `this machine`: something is not installed.

    What the conformance kit skips is in a list of each of its tests.
    """
    own = Path(kit.__file__).resolve()
    places = [report.longrepr for report in skipped if isinstance(report.longrepr, tuple)]
    reasons = [reason.removeprefix("Skipped: ") for file, _, reason in places if Path(file).resolve() != own]
    return Counter(reason for reason in reasons if not reason.startswith("this machine "))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session):
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")
    if not session.config.getoption("whole") or terminal is None:
        return
    if lacking := lacking_skips(terminal.stats.get("skipped", ())):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        for reason, count in lacking.items():
            terminal.write_line(f"\nexpected all to be installed, {count} skipped: {reason}", red=True)


def _elsewhere(item):
    marker = item.get_closest_marker("apart")
    return marker is not None and any(find_spec(module) is None for module in marker.args)


def _job_of(item):
    return next((job for job in JOBS if item.get_closest_marker(job)), None)


def pytest_collection_modifyitems(config, items):
    """Files that take long come first, so that no process is left alone with one at the end."""
    job = config.getoption("job")
    left_out = {item for item in items if _elsewhere(item) or _job_of(item) != job}
    if left_out:
        config.hook.pytest_deselected(items=[*left_out])
        items[:] = [item for item in items if item not in left_out]
    weights = {"slow": 60.0, "ray": 8.0, "simulator": 5.0}
    seconds = Counter()
    for item in items:
        seconds[item.path] += 0.1 + sum(weight for mark, weight in weights.items() if item.get_closest_marker(mark))
    items.sort(key=lambda item: -seconds[item.path])


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Tests and the modules that they import stay to the end: the garbage collector need not look at them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()
