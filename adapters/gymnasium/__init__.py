"""The adapter of any gymnasium environment that a mapping file describes. Light: gymnasium is imported on opening."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.gymnasium.mapping import FILES, definition, load_description
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.gymnasium import simulation

    return simulation.open_environment(task, view)


SIMULATOR = Simulator(
    name="gymnasium",
    title="gymnasium (by mapping file)",
    tasks={task: load_description(path) for task, path in FILES.items()},
    modules=("gymnasium",),
    distributions=("gymnasium", "gymnasium-robotics", "panda-gym", "mujoco", "pybullet"),
    references=(references.GYMNASIUM_ROBOTICS, references.MUJOCO),
    open=_open,
    definitions={task: definition(path) for task, path in FILES.items()},
    environment={"MUJOCO_GL": "egl"},
)
