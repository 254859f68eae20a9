"""The suite `ablations`: what a merge costs by part, by the blocks that tasks keep and by lambda; see `operators`."""

from collections.abc import Mapping, Sequence
from typing import Any

from studies.merging.operators import PARTS, parts_of, played
from studies.shared import table_of
from studies.tables import episodes_of, write_episodes


def measure() -> list[dict[str, Any]]:
    """A row for each policy; writes the episodes beside the rows."""
    frame, sizes = played("ablations")
    write_episodes("ablations", frame, ("policy", "task", "seed"))
    rows = parts_of(frame, sizes)
    table_of(rows, PARTS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes; sizes are taken from the rows."""
    return parts_of(episodes_of("merging", "ablations"), {row["policy"]: row["kilobytes"] for row in rows})
