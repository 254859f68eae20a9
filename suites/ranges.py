"""Ranges of numbers and texts that come from outside, in suites and on the command line."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, PlainSerializer

from robogauntlet.suites.timing import Timing, read_timing

MAX_COUNT = 1_000_000_000
"""Largest whole number that is accepted anywhere; smaller where more makes no sense."""
MAX_SEEDS = 10_000_000
MAX_FIRST_SEED = 2**31 - 1
SMALLEST_IMAGE, LARGEST_IMAGE = 16, 1024
"""Width and height (px)."""
MAX_STEPS = 1_000_000
"""Control steps of an episode."""
MAX_WORKERS = 10_000
MAX_ATTEMPTS = 1_000
MAX_ENTRIES = 10_000
"""Entries of a list."""
MAX_PATTERNS = 100
"""Patterns of tasks in a suite."""
MAX_CELLS = 1_000_000
"""Combinations of task, policy and condition in a suite."""
MAX_TEXT = 10_000
"""Characters of a text, or of an argument on the command line."""
MAX_NAME = 80
MAX_NUMBER = 1e12
MAX_FILE_NAME = 255
"""Bytes of the name of a file or folder."""
MAX_PATH = 4095
"""Bytes of a path."""

Steps = Annotated[int, Field(strict=True, ge=1, le=MAX_STEPS)]
Workers = Annotated[int, Field(strict=True, ge=1, le=MAX_WORKERS)]
Attempts = Annotated[int, Field(strict=True, ge=1, le=MAX_ATTEMPTS)]
SeedNumber = Annotated[int, Field(strict=True, ge=1, le=MAX_SEEDS)]
FirstSeed = Annotated[int, Field(strict=True, ge=0, le=MAX_FIRST_SEED)]
Text = Annotated[str, Field(max_length=MAX_TEXT)]
ImageSize = Annotated[int, Field(strict=True, ge=SMALLEST_IMAGE, le=LARGEST_IMAGE)]
StatedTiming = Annotated[Timing | None, BeforeValidator(read_timing), PlainSerializer(lambda it: it and str(it))]
"""A text or a mapping, see `read_timing`."""
