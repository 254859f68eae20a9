"""The adapter of ManiSkill 3 (SAPIEN). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.maniskill.tasks import TASKS
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.maniskill import simulation

    return simulation.open_task(task, view)


SIMULATOR = Simulator(
    name="maniskill",
    title="ManiSkill 3 (SAPIEN)",
    tasks=TASKS,
    modules=("mani_skill", "sapien", "torch"),
    distributions=("mani-skill", "sapien", "torch", "fast-simplification"),
    references=(references.MANISKILL, references.SAPIEN),
    open=_open,
    adjusts=frozenset({"cameras", "lights", "objects", "arm", "dynamics", "table"}),
    environment={"LP_NUM_THREADS": "1"},
    newest_python="3.12",
)
