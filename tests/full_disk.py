"""A full disk, simulated by an error or a limit on the size of files."""

import contextlib
import resource
from collections.abc import Iterator


def no_space(*arguments, **options):
    """Fails as a write to a full disk does."""
    raise OSError(28, "No space left on device")


@contextlib.contextmanager
def full_disk(after: int = 1000) -> Iterator[None]:
    """Within the block no file grows beyond `after` bytes: writing fails as on a full disk, with "File too large"."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (after, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
