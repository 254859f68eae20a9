"""The suite `ablations`: what a merge costs by part, by the blocks that tasks keep and by lambda; see `operators`."""

from collections.abc import Mapping, Sequence
from typing import Any

from studies.merging.operators import again, measured


def measure() -> list[dict[str, object]]:
    """A row for each policy; writes the episodes beside the rows."""
    return measured("ablations")


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, object]]:
    """The rows again, from the kept episodes."""
    return again("ablations", rows)
