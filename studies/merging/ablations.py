"""The suite `ablations`: what a merge costs by part, by the blocks that tasks keep and by lambda; see `operators`."""

from tests.benchmarks.operators import measured


def measure() -> list[dict[str, object]]:
    """A row for each policy; writes the episodes beside the rows."""
    return measured("ablations")
