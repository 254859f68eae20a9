"""What came out: the record of an episode, the store, statistics, tables and reports.

In a notebook: `results.open("runs/today").episodes()` is a DataFrame, and `results.compare("runs/today", "runs/old")`
prints itself.
"""

from __future__ import annotations

from typing import Any

__all__ = ["compare", "open"]


def __getattr__(name: str) -> Any:
    """What notebooks use, loaded when it is used."""
    if name not in __all__:
        raise AttributeError(f"module 'results' has no attribute '{name}'")
    from results import opening

    return opening.open_run if name == "open" else opening.compare
