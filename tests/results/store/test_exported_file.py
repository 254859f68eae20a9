"""Exported runs that were made to do harm: each is refused in one line, and soon.

They are read here as `limited_reader` reads them in a process of its own. That a refused file leaves nothing is tested
in test_run_archive.py.
"""

import sqlite3
import time
from contextlib import closing
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robogauntlet.results.record import FailureKind, outcome_row, rows_hash
from robogauntlet.results.run_document import RunError, read_run, store_url
from robogauntlet.results.store import exported_file
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_file import LONGEST_VALUE, ExportedRun, open_exported
from robogauntlet.results.store.limited_reader import Copier
from robogauntlet.results.store.run_archive import export_run, import_run
from robogauntlet.results.store.schema import VERSION
from tests.bad_input.forged import exported_with
from tests.errors import one_line_error
from tests.results.store.earlier import LATER, SQL, as_version_1
from tests.results.synthetic import cells, document, execute, row, run_folder

RESULTS = [row(cell, seed) for cell in cells() for seed in range(3)]


def export(root, results=RESULTS, **changes):
    """An exported run of these rows."""
    run_id = "0123456789abcdef0123456789abcdef"
    run = document(3, **{"run_id": run_id, "rows_hash": rows_hash(map(outcome_row, results)), **changes})
    folder = run_folder(root / "theirs", run, results)
    with closing(Store.open(store_url(folder, run), run_id)) as store:
        export_run(run, store, root / "run.robogauntlet")
    return root / "run.robogauntlet"


@cache
def sound():
    with TemporaryDirectory() as root:
        return export(Path(root)).read_bytes()


@pytest.fixture
def file(tmp_path):
    """An exported run of `RESULTS`."""
    path = tmp_path / "run.robogauntlet"
    path.write_bytes(sound())
    return path


def refuse(file, match=None):
    """Expects that the file is refused in one line after little computing."""
    folder = file.parent / "copy"
    folder.mkdir()
    began = time.process_time()  # a busy machine takes longer
    with one_line_error(RunError, match) as caught, closing(Copier(file, folder)) as copier:
        copier.copy_rows()
    assert time.process_time() - began < 30
    assert len(str(caught.value)) < 500


def taken(file):
    """The rows that are copied from the file, by seed."""
    folder = file.parent / "copy"
    folder.mkdir()
    with closing(Copier(file, folder)) as copier:
        copier.copy_rows()
    run = read_run(folder)
    with closing(Store.open(store_url(folder, run), run.run_id, create=False)) as store:
        return sorted(store.results(), key=lambda r: r.seed)


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT"


def as_view(table, *columns):
    """Statements that replace a table by an endless view with these values."""
    return (f"ALTER TABLE {table} RENAME TO old", f"CREATE VIEW {table} AS {ENDLESS} {', '.join(columns)} FROM n, old")


SCHEMAS = {
    "endless view": as_view("episodes", "old.*"),
    "endless condition": (
        "ALTER TABLE runs RENAME TO old",
        f"CREATE VIEW runs AS SELECT * FROM old WHERE EXISTS ({ENDLESS} x FROM n WHERE x < 0)",
    ),
    "trigger": ("CREATE TRIGGER late AFTER INSERT ON runs BEGIN DELETE FROM episodes; END",),
    "view beside": (f"CREATE VIEW beside AS {ENDLESS} x FROM n",),
    "table beside": ("CREATE TABLE beside (x)",),
    "virtual table": ("CREATE VIRTUAL TABLE beside USING fts5(x)",),
    "index beside": ("CREATE INDEX beside ON episodes (abs(seed))",),
    "generated column": ("ALTER TABLE runs ADD COLUMN later AS (zeroblob(1000000000))",),
    "column beside": ("ALTER TABLE episodes ADD COLUMN beside",),
    "index missing": ("DROP INDEX robogauntlet_what_is_there",),
    "column missing": ("ALTER TABLE episodes DROP COLUMN failure",),
    "table missing": ("DROP TABLE episodes",),
    "view of all": ("ALTER TABLE episodes RENAME TO e", "CREATE VIEW episodes AS SELECT * FROM e"),
    "statistics": ("ANALYZE",),
}


@pytest.mark.parametrize("statements", SCHEMAS.values(), ids=SCHEMAS)
def test_a_schema_that_is_not_ours_to_the_letter_is_refused(file, statements):
    execute(file, *statements)
    refuse(file, "its tables are not those of this program")


def test_a_table_may_be_of_text_as_long_as_the_limit_and_no_longer(file):
    execute(file, f"UPDATE runs SET document = printf('%.*c', {LONGEST_VALUE + 1}, 'x')")
    refuse(file, "it has a value of more than")


def test_reading_ends_at_its_deadline(tmp_path, monkeypatch):
    file = export(tmp_path, [row(cell, seed) for cell in cells() for seed in range(300)])
    monkeypatch.setattr(exported_file, "MIN_TIME_S", -1e6)
    with one_line_error(RunError, "reading it takes too long"), open_exported(file) as exported:
        list(exported.rows())


VALUES = {
    "text for a number": ("steps = 'many'", "steps is of another type"),
    "bytes for text": ("policy = x'ff00'", "policy is of another type"),
    "null": ("delivered = 'much'", "delivered is of another type"),
    "infinity": ("reward_sum = 9e999", "reward_sum is no finite number"),
    "negative": ("seed = -1", "seed is out of bounds"),
    "beyond 2^53": ("steps = 9007199254740993", "steps is out of bounds"),
    "beyond all": ("steps = 9223372036854775807", "steps is out of bounds"),
    "two for true": ("success_once = 2", "success_once is neither true nor false"),
    "long": ("error = printf('%.*c', 200000, 'x')", "error is too long"),
    "status": ("status = 'won'", "its status or render profile is unknown"),
    "profile": ("render_profile = 'none'", "its status or render profile is unknown"),
    "another seed": ("seed = seed + 1", "its id is not that of its episode"),
    "another pair": ("pair_id = 'x'", "its id is not that of its episode"),
    "another episode": ("episode_id = substr(episode_id, 1, 15) || 'x'", "its id is not that of its episode"),
    "another simulator": ("simulator = 'x'", "its id is not that of its episode"),
    "another task": ("task = 'null/Reach'", "it is not planned"),
    "another policy": ("policy_digest = 'x'", "it is not planned"),
    "huge images": ("image_size = 1000000", "its protocol is not that of the suite"),
    "another protocol": ("protocol = 'openvla'", "its protocol is not that of the suite"),
    "its own protocol by name": ("protocol = 'robogauntlet'", "its protocol is not that of the suite"),
    "another rule of success": ("success_rule = 'once'", "its protocol is not that of the suite"),
    "its own rule of success by name": ("success_rule = 'held'", "its protocol is not that of the suite"),
    "an empty protocol": ("protocol = ''", "its protocol is not that of the suite"),
    "endless": ("horizon = 1000000000", "horizon is out of bounds"),
    "scores": ("routing_scores = '[]'", "routing_scores are no scores by name"),
    "half of scores": ("routing_scores = '['", "routing_scores are no scores by name"),
    "nested scores": ("routing_scores = printf('%.*c', 90000, '[')", "routing_scores are no scores by name"),
    "a path backwards": ("path_length = -0.5", "path_length is out of bounds"),
    "an endless path": ("path_length = 9e999", "path_length is no finite number"),
    "smoother than smooth": ("smoothness = 0.5", "smoothness is out of bounds"),
    "endlessly smooth": ("smoothness = 9e999", "smoothness is no finite number"),
    "success before the start": ("time_to_success = -1.0", "time_to_success is out of bounds"),
    "beyond the goal": ("progress = 1.5", "progress is out of bounds"),
    "far from the goal": ("progress = -1.5", "progress is out of bounds"),
    "a force that pulls": ("contact_force = -0.1", "contact_force is out of bounds"),
    "force in words": ("contact_force = 'much'", "contact_force is of another type"),
    "half a step": ("contact_steps = 1.5", "contact_steps is of another type"),
    "negative steps": ("workspace_steps = -1", "workspace_steps is out of bounds"),
    "openings in words": ("gripper_openings = 'two'", "gripper_openings is of another type"),
    "openings beyond the steps": ("gripper_openings = steps + 1", "gripper_openings is larger than steps"),
    "contacts beyond the steps": ("contact_steps = steps + 1", "contact_steps is larger than steps"),
    "limits beyond the steps": ("joint_limit_steps = steps + 1", "joint_limit_steps is larger than steps"),
    "outside beyond the steps": ("workspace_steps = steps + 1", "workspace_steps is larger than steps"),
    "unknown failure": ("failure = 'bored'", "its failure is of an unknown kind"),
    "failed success": ("failure = 'dropped'", "it has a kind of failure and another status"),
    "success of a failure": (
        "status = 'failure', time_to_success = 1.0",
        "it has a time to success and another status",
    ),
    "behaviour of an error": ("status = 'error', path_length = 1.0", "it is an error and has a behaviour"),
    "a failure as bytes": ("failure = x'00'", "failure is of another type"),
    "another measurement": ("path_length = 1.0", "it was changed"),
    "another run": ("run_id = 'x'", "rows of several"),
    "another error": ("error = '5'", "it was changed"),
    "another outcome": ("steps = steps + 1", "it was changed"),
}


@pytest.mark.parametrize(("change", "words"), VALUES.values(), ids=VALUES)
def test_a_row_that_this_program_did_not_write_is_refused(file, change, words):
    execute(file, f"UPDATE episodes SET {change} WHERE rowid = 5")
    refuse(file, words)


def test_text_that_is_not_utf_8_is_refused(file):
    execute(file, "UPDATE runs SET document = CAST(x'7bff' AS TEXT)")
    refuse(file, "text that is not UTF-8")


HUGE = 2**63
DOCUMENTS = {
    "no hash": ("rows_hash", None, "expected a hash of the rows of a complete run, it has none"),
    "another hash": ("rows_hash", "0" * 16, "its rows hash to .*: it was changed"),
    "another id": ("run_id", "f" * 32, "its run id is not one of this program"),
    "a short id": ("run_id", "good", "its run id is not one of this program"),
    "a path as id": ("run_id", "../../x", "its run id is not one of this program"),
    "a time": ("started_at", 1e20, "started_at"),
    "a time before": ("finished_at", -1e20, "finished_at"),
    "a type": ("started_at", "yesterday", "started_at"),
    "a text for a plan": ("plan", "all", "plan"),
    "a list for a suite": ("suite", (1, 2), "suite"),
    "a number for a text": ("suite_text", 5, "suite_text"),
    "a number": ("media_left_out", HUGE, "media_left_out"),
    "no number": ("elapsed_s", float("nan"), "elapsed_s"),
    "a plan without end": ("plan:0:planned", HUGE, "planned"),
    "a severity below 0": ("plan:0:severity", -1, "severity"),
    "a name": ("suite_path", "x" * 3_000_000, "suite_path"),
    "a long policy": ("plan:0:policy", "x" * 3_000_000, "expected a run document"),
    "a long description": ("suite:description", "x" * 3_000_000, "expected a run document"),
    "a key": ("\x1b[31m" * 1000, 1, "expected a run document"),
    "a colour in a policy": ("plan:0:policy", "a\x1b[31m", "a name in its plan has control characters"),
    "reversed text in a task": ("plan:0:task", "a\u202eb", "a name in its plan has control characters"),
    "two lines in an axis": ("plan:0:axis", "a\nb", "a name in its plan has control characters"),
    "a NUL in a simulator": ("plan:0:simulator", "\0", "a name in its plan has control characters"),
    "another policy": ("plan:0:policy_digest", "other", "a row is not one of this program: it is not planned"),
    "small images": ("suite:image_size", 32, "its protocol is not that of the suite"),
    "a gate that is not played": ("suite:oracle_gate", "nobody", "compares policy 'nobody', which it does not play"),
}


@pytest.mark.parametrize(("place", "value", "words"), DOCUMENTS.values(), ids=DOCUMENTS)
def test_a_document_that_this_program_did_not_write_is_refused(file, place, value, words):
    file.write_bytes(exported_with(place, value, sound()))
    refuse(file, words)


TABLES = {
    "no run": ("DELETE FROM runs", "expected one exported run, got none"),
    "two runs": (
        "INSERT INTO runs (run_id, started_at, document, suite, status, planned) VALUES ('x', 1, '', '', '', 1)",
        "expected one exported run, got several",
    ),
    "bytes for a document": ("UPDATE runs SET document = x'00ff'", "expected the document of a run as text"),
    "an empty document": ("UPDATE runs SET document = ''", "expected a run document of format 1"),
    "no rows": ("DELETE FROM episodes", "its rows hash to .*: it was changed"),
    "a row less": ("DELETE FROM episodes WHERE rowid = 5", "its rows hash to .*: it was changed"),
    "no version": ("DELETE FROM robogauntlet_schema", f"of version {VERSION}, got no version"),
}


@pytest.mark.parametrize(("statement", "words"), TABLES.values(), ids=TABLES)
def test_tables_that_are_not_those_of_one_run_are_refused(file, statement, words):
    execute(file, statement)
    refuse(file, words)


TORN = {
    "half": lambda good: good[: len(good) // 2],
    "less than a page": lambda good: good[:511],
    "a damaged page": lambda good: good[:4096] + b"\xff" * 4096 + good[8192:],
    "a damaged head": lambda good: b"\xff" * 100 + good[100:],
    "backwards": lambda good: good[::-1],
}


@pytest.mark.parametrize("change", TORN.values(), ids=TORN)
def test_a_torn_file_is_refused(file, change):
    file.write_bytes(change(sound()))
    refuse(file, "expected an exported run")


def test_rows_are_not_larger_than_their_file(file):
    """Rows of a forged file may share its pages, and would then need any amount of memory."""
    with closing(sqlite3.connect(file)) as connection:
        assert len(list(ExportedRun(file, file.stat().st_size, connection).rows())) == len(RESULTS)
        with one_line_error(RunError, "its rows are larger than the file"):
            list(ExportedRun(file, 2000, connection).rows())


def test_the_origin_is_not_the_senders_to_choose(tmp_path):
    _, run = import_run(export(tmp_path, origin="local", command="rm -r /"), tmp_path / "there")
    assert (run.origin, run.command) == ("imported", None)


def test_an_export_of_before_the_tables_of_marks_is_taken(file):
    execute(file, "DROP TABLE imported_runs", "DROP TABLE forgotten_runs")
    assert len(taken(file)) == len(RESULTS)


@pytest.mark.parametrize("version", SQL)
def test_the_tables_of_each_version_are_kept_to_the_letter(version):
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(SQL[version])
        assert exported_file._own_schema(version) == exported_file._schema_of(connection)
    assert max(SQL) == VERSION


def test_an_export_of_version_1_is_taken_and_its_rows_have_no_behaviour(tmp_path):
    file = as_version_1(export(tmp_path))
    before = file.read_bytes()
    folder, run = import_run(file, tmp_path / "there")
    with closing(Store.open(store_url(folder, run), run.run_id, create=False)) as store:
        found = list(store.results())
    assert sorted(found, key=lambda r: r.episode_id) == sorted(RESULTS, key=lambda r: r.episode_id)
    assert rows_hash(map(outcome_row, found)) == run.rows_hash
    assert file.read_bytes() == before


OTHER_TABLES = {
    "version 1 called 2": ("UPDATE robogauntlet_schema SET version = 2",),
    "one later column": ("ALTER TABLE episodes ADD COLUMN path_length FLOAT",),
    "all later columns at the end": [f"ALTER TABLE episodes ADD COLUMN {name}" for name in LATER],
    "column beside": ("ALTER TABLE episodes ADD COLUMN beside",),
    "index missing": ("DROP INDEX robogauntlet_what_is_there",),
}


@pytest.mark.parametrize("statements", OTHER_TABLES.values(), ids=OTHER_TABLES)
def test_a_schema_that_is_not_version_1_to_the_letter_is_refused(tmp_path, statements):
    file = as_version_1(export(tmp_path))
    execute(file, *statements)
    refuse(file, "its tables are not those of this program")


def test_tables_of_this_version_that_are_called_version_1_are_refused(file):
    execute(file, "UPDATE robogauntlet_schema SET version = 1")
    refuse(file, "its tables are not those of this program")


@pytest.mark.parametrize("version", ["0", "5", "-1", "9223372036854775807"])
def test_an_export_of_another_version_is_refused(file, version):
    execute(file, f"UPDATE robogauntlet_schema SET version = {version}")
    refuse(file, f"expected an exported run of version {VERSION}, got version {version}; import it with")


def test_measured_behaviour_is_imported_with_every_kind_of_failure(tmp_path):
    numbers = {"path_length": 0.0, "smoothness": -12.5, "progress": -1.0, "contact_steps": 100, "contact_force": 3.5}
    failed = [row(cells()[0], 5 + n, "failure", failure=str(kind), **numbers) for n, kind in enumerate(FailureKind)]
    won = row(cells()[0], 0, time_to_success=1.25, gripper_openings=1, joint_limit_steps=0, workspace_steps=40)
    lost = row(cells()[0], 1, "error")
    assert taken(export(tmp_path, [*failed, won, lost])) == [won, lost, *failed]


@settings(max_examples=150)
@given(data=st.data())
def test_flipped_bytes_are_a_run_or_an_error_of_one_line(data):
    content = bytearray(sound())
    places = st.one_of(st.integers(0, len(content) - 1), st.integers(0, 8192))
    for place, value in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), min_size=1, max_size=20)):
        content[place] = value
    length = data.draw(st.one_of(st.just(len(content)), st.integers(1, len(content))))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "run.robogauntlet"
        file.write_bytes(bytes(content[:length]))
        try:
            with closing(Copier(file, Path(folder))) as copier:
                copier.copy_rows()
        except (RunError, StoreError) as error:
            message = str(error)
        else:
            return
        assert "\n" not in message
