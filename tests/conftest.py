"""What all tests share."""

import os

from hypothesis import settings

from adapters import catalog

# How long an example takes says something about the machine and what else it does, nothing about the code.
settings.register_profile("whatever the time", deadline=None)
settings.load_profile("whatever the time")

# Tests open several simulators in one process, so what each asks for must be set before the first is imported.
for _simulator in catalog.simulators().values():
    for _name, _value in _simulator.environment.items():
        os.environ.setdefault(_name, _value)
os.environ.setdefault("OMP_NUM_THREADS", "1")
