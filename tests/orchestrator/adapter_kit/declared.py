"""What the entry points of the liars point at."""

from robogauntlet.orchestrator.adapter_kit.scaffold.template.robogauntlet_toysim.oracle import Reach
from tests.orchestrator.adapter_kit import camera_liars, object_liars  # noqa: F401  register them
from tests.orchestrator.adapter_kit.liars import LIARS


def __getattr__(name):
    if name.startswith("oracle_"):
        return {f"{name.removeprefix('oracle_')}/Reach": Reach}
    if name in LIARS:
        return LIARS[name]
    raise AttributeError(name)
