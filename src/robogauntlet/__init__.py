"""Reproducible, statistically sound evaluation of robot policies across simulators.

What is exported here is kept stable, with the two contracts `robogauntlet.adapters.contract` and
`robogauntlet.policies.contract`. Names load when they are first used, so importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robogauntlet.adapters.contract import (
        ActionSpec as ActionSpec,
        Observation as Observation,
        Simulation as Simulation,
        Simulator as Simulator,
    )
    from robogauntlet.orchestrator.api.bisection import bisect as bisect
    from robogauntlet.orchestrator.api.evaluation import EvaluationStopped as EvaluationStopped, evaluate as evaluate
    from robogauntlet.orchestrator.api.tasks import make as make
    from robogauntlet.policies.contract import Decision as Decision, Policy as Policy, PolicySpec as PolicySpec
    from robogauntlet.results.api import OpenRun as OpenRun, compare as compare, open_run as open_run
    from robogauntlet.results.record import EpisodeResult as EpisodeResult
    from robogauntlet.suites.episode import Episode as Episode

    __version__: str

_MODULES = {
    "adapters.contract": ("ActionSpec", "Observation", "Simulation", "Simulator"),
    "orchestrator.api.bisection": ("bisect",),
    "orchestrator.api.evaluation": ("EvaluationStopped", "evaluate"),
    "orchestrator.api.tasks": ("make",),
    "policies.contract": ("Decision", "Policy", "PolicySpec"),
    "results.api": ("OpenRun", "compare", "open_run"),
    "results.record": ("EpisodeResult",),
    "suites.episode": ("Episode",),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}
__all__ = ["__version__", *_MODULE_OF]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value = version("robogauntlet")
    elif name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
    else:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
