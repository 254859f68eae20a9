"""The adapter of Meta-World (MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.metaworld.tasks import TASKS
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.metaworld import simulation

    return simulation.MetaWorldSimulation(task, view)


SIMULATOR = Simulator(
    name="metaworld",
    title="Meta-World (MuJoCo)",
    tasks=TASKS,
    modules=("metaworld", "mujoco"),
    distributions=("metaworld", "mujoco", "gymnasium"),
    references=(references.METAWORLD, references.MUJOCO),
    open=_open,
    environment={"MUJOCO_GL": "egl"},
)
