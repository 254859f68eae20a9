"""The adapter of gymnasium environments, each by a class that says what its numbers mean. Imports no gymnasium."""

from collections.abc import Iterable
from typing import Any

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import Simulation, Simulator, TaskDescription
from robogauntlet.adapters.gymnasium.aloha import AlohaInsertion, AlohaTransferCube
from robogauntlet.adapters.gymnasium.mapping import Base, EnvironmentMapping, Moment
from robogauntlet.adapters.gymnasium.pusht import PushT
from robogauntlet.adapters.gymnasium.tasks import MAPPINGS
from robogauntlet.suites.episode import View

__all__ = ["Base", "EnvironmentMapping", "Moment", "declare"]


def declare(name: str, title: str, mappings: Iterable[type[EnvironmentMapping]], **more: Any) -> Simulator:
    """Return a simulator whose tasks are these mappings, for an entry point of the group `robogauntlet.simulators`.

    Args:
        name: Name of the simulator, and of the entry point.
        title: Its name for people.
        mappings: One class for each task.
        more: Further fields of the `Simulator`, such as `distributions`, whose versions belong to the provenance.
    """
    known = {mapping.name: mapping for mapping in mappings}

    def open_task(task: str, view: View) -> Simulation:
        from robogauntlet.adapters.gymnasium.simulation import GymnasiumSimulation

        return GymnasiumSimulation(known[task](), view)

    return Simulator(
        name=name,
        title=title,
        tasks={task: _description(mapping) for task, mapping in known.items()},
        open=open_task,
        **{"modules": ("gymnasium",), "distributions": ("gymnasium",), "environment": {"MUJOCO_GL": "egl"}, **more},
    )


def _description(mapping: type[EnvironmentMapping]) -> TaskDescription:
    module, colon, _ = mapping.env.partition(":")
    return TaskDescription(
        mapping.instruction,
        mapping.horizon,
        cameras=mapping.cameras,
        modules=(module,) if colon else (),
        goal=mapping.goal,
        arms=mapping.action_spec.arms,
        joints=mapping.action_spec.body.joints,
        native=mapping.action_spec.body.native,
        state=mapping.action_spec.state,
    )


SIMULATOR = declare(
    "gymnasium",
    "gymnasium (by mapping)",
    (*MAPPINGS, PushT, AlohaTransferCube, AlohaInsertion),
    distributions=(
        *("gymnasium", "gymnasium-robotics", "panda-gym", "gym-pusht", "gym-aloha", "dm-control", "mujoco", "pybullet"),
    ),
    references=(references.GYMNASIUM_ROBOTICS, references.ALOHA, references.MUJOCO),
)
