"""Exported runs: files that are none, that are damaged, and whose author meant harm.

Some of each kind, since each starts a process; tests/results/store/test_exported_file.py has all.
"""

from functools import partial

from tests.bad_input.case import Case, table
from tests.bad_input.forged import exported_after, exported_with

FILE = "run.robogauntlet"
VALUES = {
    ("started_at", "yesterday"): "expected a run document",
    ("plan:0:policy", "x" * 3_000_000): "expected a run document",
    ("run_id", "../../x"): "its run id is not one of this program",
    ("rows_hash", "0" * 64): "its rows hash to",
    ("plan:0:policy", "a\x1b[31m"): "a name in its plan has control characters",
    ("plan:0:policy_digest", "other"): "a row is not one of this program: it is not planned",
    ("suite:oracle_gate", "nobody"): "its suite compares policy 'nobody', which it does not play",
}
SQL = {
    "DELETE FROM runs": "expected one exported run, got none",
    "UPDATE runs SET document = CAST(x'ff' AS TEXT)": "it has text that is not UTF-8",
    "UPDATE episodes SET seed = -1": "seed is out of bounds",
    "UPDATE robogauntlet_schema SET version = 99": "expected an exported run of version",
    "CREATE TRIGGER t AFTER INSERT ON runs BEGIN SELECT 1; END": "its tables are not those of this program",
}
CASES = [
    *table(
        ("import nowhere", "nowhere: expected an exported run (`robogauntlet export`), there is no such file"),
        ("import text", "text: expected an exported run (`robogauntlet export`), this file is something else"),
        ("import empty", "empty: expected an exported run (`robogauntlet export`), this file is empty"),
        ("import byte", "byte: expected an exported run (`robogauntlet export`), this file is something else"),
        ("import notes", "notes: expected an exported run (`robogauntlet export`), this is a directory"),
        ("import runs/monday", "expected an exported run (`robogauntlet export`), this is a directory"),
        ("import runs/monday/episodes.sqlite", "expected one exported run, got none"),
        ("import /dev/null", "expected an exported run (`robogauntlet export`), this is no file"),
        ("import run.robogauntlet --out .", "--out: expected the name of a new folder, got '.'"),
        ("import run.robogauntlet --out ..", "--out: expected the name of a new folder, got '..'"),
        ("import run.robogauntlet --out /", "--out: expected the name of a new folder, got '/'"),
        ("import run.robogauntlet --out runs/..", "--out: expected the name of a new folder"),
        (
            "import run.robogauntlet --out text",
            "text: expected a new folder, there is one already; name another with --out",
        ),
        ("import run.robogauntlet --out text/new", "text: cannot be written: expected a folder, this is a file"),
        (
            "import run.robogauntlet --out runs/monday",
            "expected a new folder, there is one already; name another with --out",
        ),
    ),
    *(
        Case("import run.robogauntlet --out new", says, {FILE: partial(exported_with, *at)})
        for at, says in VALUES.items()
    ),
    *(
        Case("import run.robogauntlet --out new", says, {FILE: partial(exported_after, sql)})
        for sql, says in SQL.items()
    ),
    *(
        Case("import run.robogauntlet --out new", "expected an exported run", {FILE: change})
        for change in (
            lambda good: good[: len(good) // 2],
            lambda good: good[:4096] + b"\xff" * 4096 + good[8192:],
        )
    ),
]
