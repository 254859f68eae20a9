"""A share of a measurement: `PERCENT=1 python -m studies NAME --measure TABLE` shows whether it goes through.

As scripts/percent.sh does for the training scripts, whose folders of the same share are read. What comes of it is no
measurement: it is written beside those of the whole, and cannot be kept.
"""

import os
import re
import sys
from pathlib import Path

_GIVEN = os.environ.get("PERCENT", "")
if not re.fullmatch("([1-9][0-9]{0,2})?", _GIVEN):
    print(f"PERCENT: expected a whole number from 1 to 999, got '{_GIVEN}'", file=sys.stderr)
    sys.exit(2)
PERCENT = int(_GIVEN or 100)
IS_PART = PERCENT < 100
SUFFIX = f"-{_GIVEN}-percent" if _GIVEN else ""
"""What folders of a share are called after those of the whole."""
LACKING = 3
"""The exit code of a measurement that needs what the machine lacks."""


def few(count: int, least: int = 2) -> int:
    """That share of a count; at least `least`, or all if they are fewer."""
    return max(count * PERCENT // 100, min(least, count))


def folder_of(variable: str, name: str) -> Path:
    """The folder that an environment variable names, by default that of `name` in runs/, of the same share."""
    return Path(os.environ.get(variable, f"runs/{name}{SUFFIX}")).absolute()
