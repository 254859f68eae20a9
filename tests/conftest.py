"""Fixtures that all tests share."""

import gc
import os
import signal
import tempfile
from collections import Counter

import pytest
from hypothesis import settings

from robogauntlet.adapters import catalog

# The duration of an example depends on the load of the machine, not on the code.
settings.register_profile("whatever the time", deadline=None)
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

# Tests open several simulators in one process, so the variables of all are set before the first is imported.
for _simulator in catalog.simulators().values():
    for _name, _value in _simulator.environment.items():
        os.environ.setdefault(_name, _value)
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_collection_modifyitems(items):
    """Files that take long come first, so that no process is left alone with one at the end."""
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
