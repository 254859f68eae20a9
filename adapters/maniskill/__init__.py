"""The adapter of ManiSkill 3 (SAPIEN). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.maniskill.native_tasks import TASKS as NATIVE
from robogauntlet.adapters.maniskill.tasks import ADJUSTS, TASKS
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    if task in NATIVE:
        from robogauntlet.adapters.maniskill.native import NativeSimulation

        return NativeSimulation(task, view)
    from robogauntlet.adapters.maniskill import simulation

    return simulation.open_task(task, view)


SIMULATOR = Simulator(
    name="maniskill",
    title="ManiSkill 3 (SAPIEN)",
    tasks=TASKS | NATIVE,
    modules=("mani_skill", "sapien", "torch"),
    distributions=("mani-skill", "sapien", "torch", "fast-simplification"),
    references=(references.MANISKILL, references.SAPIEN),
    open=_open,
    adjusts=ADJUSTS,
    has_assets=True,
    environment={"LP_NUM_THREADS": "1"},
    newest_python="3.12",
)
