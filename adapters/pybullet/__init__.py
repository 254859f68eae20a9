"""The adapter of PyBullet through panda-gym. Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.pybullet.tasks import TASKS
from robogauntlet.adapters.scene_control import ADJUSTABLE
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.pybullet import simulation

    return simulation.open(task, view)


SIMULATOR = Simulator(
    name="pybullet",
    title="PyBullet (panda-gym)",
    tasks=TASKS,
    modules=("pybullet", "panda_gym"),
    distributions=("pybullet", "panda-gym", "gymnasium", "fast-simplification"),
    references=(references.PANDA_GYM, references.PYBULLET),
    open=_open,
    adjusts=ADJUSTABLE - {"starts"},
    newest_python="3.11",
)
