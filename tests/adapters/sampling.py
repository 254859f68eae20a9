"""The tasks in which what every adapter promises is checked."""

from adapters import catalog

MOST = 3
"""Tasks of a simulator that are checked: Meta-World's fifty share one arm."""
SAMPLES = {"libero": ("goal-8-put-bowl-on-plate", "object-0-alphabet-soup")}
"""Of a simulator whose first are all alike, those that differ in what they are made of."""


def tasks_here() -> list[str]:
    """Full names of the tasks to check, of the simulators that are installed in this Python environment."""
    there = [s for s in catalog.simulators().values() if s.renders and not s.internal and not catalog.missing_reason(s)]
    return [f"{s.name}/{task}" for s in there for task in SAMPLES.get(s.name, list(s.tasks)[:MOST])]
