"""What all tests share."""

import os

from adapters import catalog

# Tests open several simulators in one process, so what each asks for must be set before the first is imported.
for _simulator in catalog.simulators().values():
    for _name, _value in _simulator.environment.items():
        os.environ.setdefault(_name, _value)
os.environ.setdefault("OMP_NUM_THREADS", "1")
