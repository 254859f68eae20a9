"""Exported runs that are none, that are damaged, and whose author meant harm.

Some of each kind; tests/results/store/test_exported_run.py has all.
"""

from functools import partial

from tests.bad_input.case import Case, table
from tests.bad_input.forged import exported_row, exported_with, rewritten

FILE = "run.zip"
NONE = "expected an exported run (`robogauntlet export`): "
VALUES = {
    ("started_at", "yesterday"): "expected a run document",
    ("plan:0:policy", "x" * 3_000_000): "expected a run document",
    ("run_id", "../../x"): "its run id is not one of this program",
    ("rows_hash", "0" * 64): "these hash to",
    ("plan:0:policy_digest", "other"): "a row is not one of this program: it is not planned",
}
CHANGES = {
    "expected the rows of run": partial(exported_row, seed=-1),
    f"{NONE}it has a file '../x.mp4' too many": lambda good: rewritten(good, {"../x.mp4": b"x"}),
    f"{NONE}it has no episodes.parquet": lambda good: rewritten(good, {"episodes.parquet": None}),
    f"{NONE}this is something else, or damaged": lambda good: good[: len(good) // 2],
}
CASES = [
    *table(
        ("import nowhere", f"nowhere: {NONE}No such file or directory"),
        ("import text", f"text: {NONE}this is something else, or damaged"),
        ("import empty", f"empty: {NONE}this is something else, or damaged"),
        ("import byte", f"byte: {NONE}this is something else, or damaged"),
        ("import notes", f"notes: {NONE}run.json: No such file or directory"),
        ("import runs/monday/episodes.sqlite", f"{NONE}this is something else, or damaged"),
        ("import /dev/null", f"/dev/null: {NONE}a device, no regular file"),
        ("import run.zip --out .", "--out: expected the name of a new folder, got '.'"),
        ("import run.zip --out ..", "--out: expected the name of a new folder, got '..'"),
        ("import run.zip --out /", "--out: expected the name of a new folder, got '/'"),
        ("import run.zip --out runs/..", "--out: expected the name of a new folder"),
        ("import run.zip --out text", "text: expected a new folder, there is one already; name another with --out"),
        ("import run.zip --out text/new", "text: cannot be written: expected a folder, this is a file"),
        (
            "import run.zip --out runs/monday",
            "expected a new folder, there is one already; name another with --out",
        ),
        ("export runs/monday --format csv --media", "expected --media with --format run only, got csv"),
    ),
    *(Case("import run.zip --out new", says, {FILE: partial(exported_with, *at)}) for at, says in VALUES.items()),
    *(Case("import run.zip --out new", says, {FILE: change}) for says, change in CHANGES.items()),
]
