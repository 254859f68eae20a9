"""The adapter of robosuite (MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.robosuite.tasks import TASKS
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.robosuite import simulation

    return simulation.RobosuiteSimulation(task, view)


SIMULATOR = Simulator(
    name="robosuite",
    title="robosuite 1.5 (MuJoCo)",
    tasks=TASKS,
    modules=("robosuite", "mujoco"),
    distributions=("robosuite", "mujoco", "numba", "fast-simplification"),
    references=(references.ROBOSUITE, references.MUJOCO),
    open=_open,
    adjusts=frozenset({"cameras", "lights", "objects", "arm", "dynamics", "table"}),
    environment={"MUJOCO_GL": "egl"},
    newest_python="3.12",
)
