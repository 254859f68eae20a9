"""Exported runs: files that are none, that are damaged, and whose author meant harm."""

from functools import partial

from tests.bad_input.case import Case, table
from tests.bad_input.forged import exported_after, exported_with

FILE = "run.robogauntlet"
HUGE = 2**63
VALUES = {
    **dict.fromkeys(
        [("plan:0:planned", HUGE), ("plan:0:severity", -1), ("started_at", 1e20)], "expected a run document"
    ),
    **dict.fromkeys([("started_at", "yesterday"), ("finished_at", -1e20), ("plan", "all")], "expected a run document"),
    **dict.fromkeys([("suite", (1, 2)), ("elapsed_s", float("nan")), ("suite_text", 5)], "expected a run document"),
    **dict.fromkeys([("plan:0:policy", "x" * 3_000_000), ("suite:description", "x" * 3_000_000)], "expected a run"),
    ("run_id", "../../x"): "its run id is not one of this program",
    ("run_id", "good"): "its run id is not one of this program",
    ("rows_hash", None): "expected a hash of the rows of a complete run, it has none",
    ("rows_hash", "0" * 64): "its rows hash to",
    ("plan:0:policy", "a\x1b[31m"): "a name in its plan has control characters",
    ("plan:0:task", "a\u202eb"): "a name in its plan has control characters",
    ("plan:0:axis", "a\nb"): "a name in its plan has control characters",
    ("plan:0:simulator", "\0"): "a name in its plan has control characters",
    ("plan:0:policy_digest", "other"): "a row is not one of this program: it is not planned",
    ("suite:image_size", 32): "its protocol is not that of the suite",
    ("suite:oracle_gate", "nobody"): "its suite compares policy 'nobody', which it does not play",
}
SQL = {
    "DELETE FROM runs": "expected one exported run, got none",
    "INSERT INTO runs (run_id, started_at, document, suite, status, planned) VALUES ('x', 1, '', '', '', 1)": (
        "expected one exported run, got several"
    ),
    "UPDATE runs SET document = x'00ff'": "expected the document of a run as text",
    "UPDATE runs SET document = CAST(x'ff' AS TEXT)": "it has text that is not UTF-8",
    "UPDATE runs SET document = ''": "expected a run document of format 1",
    "UPDATE episodes SET run_id = 'x'": "expected rows of one run, got rows of several",
    "UPDATE episodes SET seed = -1": "seed is out of bounds",
    "UPDATE episodes SET seed = 'one'": "seed is of another type",
    "UPDATE episodes SET steps = 9007199254740993": "steps is out of bounds",
    "UPDATE episodes SET status = 'won'": "its status or render profile is unknown",
    "UPDATE episodes SET reward_sum = 9e999": "reward_sum is no finite number",
    "UPDATE episodes SET error = '5'": "its rows hash to",
    "UPDATE episodes SET task = 'other/Task'": "it is not planned",
    "UPDATE episodes SET episode_id = 'x' || episode_id": "its id is not that of its episode",
    "UPDATE episodes SET success_once = 2": "success_once is neither true nor false",
    "UPDATE episodes SET routing_scores = '['": "routing_scores are no scores by name",
    "UPDATE episodes SET worker = zeroblob(100)": "worker is of another type",
    "UPDATE episodes SET path_length = -1.0": "path_length is out of bounds",
    "UPDATE episodes SET smoothness = 9e999": "smoothness is no finite number",
    "UPDATE episodes SET progress = 2.0": "progress is out of bounds",
    "UPDATE episodes SET contact_steps = -1": "contact_steps is out of bounds",
    "UPDATE episodes SET contact_steps = steps + 1": "contact_steps is larger than steps",
    "UPDATE episodes SET gripper_openings = 'two'": "gripper_openings is of another type",
    "UPDATE episodes SET failure = 'bored'": "its failure is of an unknown kind",
    "UPDATE episodes SET failure = 'dropped'": "it has a kind of failure and another status",
    "DELETE FROM episodes": "its rows hash to",
    "UPDATE robogauntlet_schema SET version = 99": "expected an exported run of version",
    "DELETE FROM robogauntlet_schema": "expected an exported run of version",
    "UPDATE robogauntlet_schema SET version = 4": "expected an exported run of version 3, got version 4",
    "UPDATE robogauntlet_schema SET version = 1": "its tables are not those of this program",
    "ALTER TABLE episodes DROP COLUMN failure": "its tables are not those of this program",
    "DROP TABLE episodes": "its tables are not those of this program",
    "ALTER TABLE episodes ADD COLUMN more TEXT": "its tables are not those of this program",
    "CREATE TABLE more (a)": "its tables are not those of this program",
    "CREATE VIEW more AS SELECT 1": "its tables are not those of this program",
    "CREATE TRIGGER t AFTER INSERT ON runs BEGIN SELECT 1; END": "its tables are not those of this program",
    "ALTER TABLE episodes RENAME TO e; CREATE VIEW episodes AS SELECT * FROM e": "its tables are not those of this",
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
            lambda good: good[:511],
            lambda good: good[:4096] + b"\xff" * 4096 + good[8192:],
            lambda good: b"\xff" * 100 + good[100:],
            lambda good: good[::-1],
        )
    ),
]
