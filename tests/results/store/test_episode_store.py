"""Tests of results/store/episode_store.py."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import pytest
import sqlalchemy as sa

from robogauntlet.results.record import FIELDS, WAITING, outcome_row, rows_hash
from robogauntlet.results.store.database import UnstorableValue, without_password
from robogauntlet.results.store.episode_store import Store, StoreError, file_url
from robogauntlet.results.store.schema import VERSION
from tests.errors import one_line_error
from tests.results.synthetic import cells, document, execute, row, rows, run_folder


@pytest.fixture
def path(tmp_path):
    return tmp_path / "episodes.sqlite"


@pytest.fixture
def store(path):
    with closing(Store.open_file(path, "run-1")) as opened:
        yield opened


def test_a_row_comes_back_as_it_was_stored(store):
    stored = [row(cells()[0], 0, reward_sum=-1.25e-6, inferred_task="PickCube", routing_scores='{"a": 0.5}')]
    stored += [row(cells()[1], 1, "error", error="Fehler: größer\n<script>")]
    store.add(stored)
    assert sorted(store.results(), key=lambda r: r.seed) == stored


def test_an_episode_is_stored_once_and_its_first_row_stays(store):
    first = row(cells()[0], 0)
    assert store.add([first]) == 1
    assert store.add([row(cells()[0], 0, "failure"), row(cells()[0], 1)]) == 1
    assert store.find(first.episode_id) == first


def test_an_episode_twice_in_one_batch_is_stored_once(store):
    store.add([row(cells()[0], 0), row(cells()[0], 0)])
    assert len(list(store.results())) == 1


def test_nothing_of_a_batch_is_stored_if_one_row_cannot_be(store):
    with pytest.raises(StoreError, match="NOT NULL"):
        store.add([row(cells()[0], 0), row(cells()[0], 1, steps=None)])
    assert list(store.results()) == []


def test_adding_no_rows_adds_none(store):
    assert store.add([]) == 0


def test_runs_in_one_store_do_not_see_each_other(store, path):
    store.add([row(cells()[0], 0)])
    with closing(Store.open_file(path, "run-2")) as other:
        assert list(other.results()) == []
        assert other.add([row(cells()[0], 0), row(cells()[0], 1)]) == 2
        assert other.forget_errors() == 0
    assert len(list(store.results())) == 1


def test_rows_come_in_order_and_in_batches(store):
    made = rows(planned=10)
    store.add(made[::-1])
    got = list(store.results())
    assert got == sorted(got, key=lambda r: (r.simulator, r.task, r.policy, r.axis, r.severity, r.seed))
    batches = list(store.batches(30))
    assert [len(batch) for batch in batches] == [30, 30, 20]
    assert [tuple(line) for batch in batches for line in batch] == [
        tuple(getattr(result, name) for name in FIELDS) for result in got
    ]


def test_outcomes_say_what_is_there(store):
    cell = cells()[0]
    store.add([row(cell, 0), row(cell, 2, "failure"), row(cell, 5, "error")])
    found = store.outcomes()[cell.policy_digest, cell.task, "clean", 0]
    assert set(found) == {0, 2, 5}


def test_outcomes_are_found_without_reading_rows(store, path):
    """Reading a million rows of 340 bytes would take most of the time to continue a run."""
    asked = []
    sa.event.listen(store.database.engine, "before_cursor_execute", lambda *call: asked.append(call[2:4]))
    store.outcomes()
    ((statement, values),) = asked
    with sqlite3.connect(path) as connection:
        plan = connection.execute(f"EXPLAIN QUERY PLAN {statement}", values).fetchall()
    assert any("COVERING INDEX robogauntlet_what_is_there" in step[3] for step in plan)


def test_only_errors_are_forgotten(store):
    cell = cells()[0]
    store.add([row(cell, 0), row(cell, 1, "error"), row(cell, 2, "failure")])
    assert store.forget_errors() == 1
    assert [result.seed for result in store.results()] == [0, 2]


def test_an_episode_is_found_by_the_beginning_of_its_id(store):
    stored = [row(cells()[0], seed) for seed in range(3)]
    store.add(stored)
    assert store.find(stored[1].episode_id[:10]) == stored[1]
    assert store.find("no such id") is None
    assert store.find("%") is None
    with pytest.raises(StoreError, match="more than one"):
        store.find("")


def test_a_reader_may_read_while_another_process_writes(store, path):
    store.add(rows(planned=5))
    reader = Store.open_file(path, "run-1")
    lines = reader.results()
    next(lines)
    assert store.add([row(cells()[0], 99)]) == 1
    assert 1 + len(list(lines)) == len(rows(planned=5))
    assert len(list(reader.results())) == len(rows(planned=5)) + 1
    reader.close()


def test_several_may_create_a_store_at_the_same_time(tmp_path):
    def create(path):
        Store.open_file(path, "run-1").close()

    with ThreadPoolExecutor(4) as threads:
        for attempt in range(25):
            assert list(threads.map(create, [tmp_path / f"{attempt}.sqlite"] * 4)) == [None] * 4


def test_a_store_whose_creation_was_cut_short_is_completed(path):
    Store.open_file(path, "run-1").close()
    execute(path, "DELETE FROM robogauntlet_schema", "DROP TABLE episodes")
    with closing(Store.open_file(path, "run-1")) as store:
        assert store.add([row(cells()[0], 0)]) == 1
    Store.open_file(path, "run-1").close()


@pytest.mark.parametrize("name", ["a?b.sqlite", "100%41.sqlite", "a b#c.sqlite"])
def test_a_file_may_have_any_name(tmp_path, name):
    Store.open_file(tmp_path / name, "run-1").close()
    assert (tmp_path / name).is_file()


def test_a_store_of_version_1_gets_the_columns_that_it_lacks_and_keeps_its_rows(path):
    results = [row(cells()[0], seed) for seed in range(2)]
    with closing(Store.open_file(path, "run-1")) as store:
        store.add(results[:1])
    columns = [f"ALTER TABLE episodes DROP COLUMN {name}" for name in ("timing", *WAITING)]
    execute(path, *columns, "UPDATE robogauntlet_schema SET version = 1")
    with closing(Store.open(file_url(path), "run-1", create=False)) as store:
        assert list(store.results()) == results[:1]
        late = replace(results[1], timing="hold:80ms", held_steps=3)
        assert store.add([late]) == 1
        assert late in list(store.results())
    Store.open_file(path, "run-1").close()


@pytest.mark.parametrize("version", [0, VERSION + 1, 99])
def test_a_store_of_another_version_is_refused_and_left_as_it_was(path, version):
    Store.open_file(path, "run-1").close()
    execute(path, f"UPDATE robogauntlet_schema SET version = {version}")
    before = path.read_bytes()
    with pytest.raises(StoreError, match=f"expected a store of version {VERSION}, got version {version}; open it with"):
        Store.open_file(path, "run-1")
    assert path.read_bytes() == before


def test_the_message_for_a_store_that_cannot_be_written_says_what_to_do(path):
    path.touch()
    with pytest.raises(StoreError, match="in a place that can be written, which reading takes too; copy it to one"):
        Store.open(f"sqlite:///file:{path}?mode=ro&uri=true", "run-1")


def test_a_file_that_is_no_store_is_refused_and_unchanged(tmp_path, path):
    path.write_text("this is no database, but a text that is long enough to be looked at")
    with pytest.raises(StoreError, match="expected a store, this file is something else"):
        Store.open_file(path, "run-1")
    assert path.read_text().startswith("this is no database")
    with pytest.raises(StoreError, match="directory"):
        Store.open_file(tmp_path, "run-1")


@pytest.mark.parametrize("table", ["runs", "bookmarks"])
def test_a_database_of_another_program_is_refused_and_unchanged(path, table):
    execute(path, f"CREATE TABLE {table} (id INTEGER)")
    before = path.read_bytes()
    with pytest.raises(StoreError, match="of another program"):
        Store.open_file(path, "run-1")
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "statements",
    [
        (
            "ALTER TABLE episodes RENAME TO old",
            "CREATE VIEW episodes AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x FROM n) SELECT x FROM n",
        ),
        ("CREATE TRIGGER late AFTER INSERT ON episodes BEGIN DELETE FROM runs; END",),
    ],
    ids=["view", "trigger"],
)
@pytest.mark.parametrize("create", [True, False])
def test_a_store_whose_rows_are_computed_is_refused(path, statements, create):
    Store.open_file(path, "run-1").close()
    execute(path, *statements)
    with one_line_error(StoreError, "its episodes is computed by somebody's SQL"):
        Store.open(file_url(path), "run-1", create=create)


def test_a_person_may_add_views_of_their_own(path):
    Store.open_file(path, "run-1").close()
    execute(path, "CREATE VIEW failures AS SELECT * FROM episodes WHERE status = 'failure'")
    Store.open_file(path, "run-1").close()


@pytest.mark.parametrize("content", [b"", b"x", b"SQLite format 3\0"])
def test_an_emptied_store_is_not_taken_for_a_new_one(path, content):
    path.write_bytes(content)
    with one_line_error(StoreError, "expected a store, this file is"):
        Store.open(file_url(path), "run-1", create=False)
    assert path.read_bytes() == content


def test_a_file_too_short_for_a_database_is_not_overwritten(path):
    path.write_bytes(b"x")
    with one_line_error(StoreError, "expected a store, this file is something else"):
        Store.open_file(path, "run-1")
    assert path.read_bytes() == b"x"


def test_opening_what_exists_creates_nothing(tmp_path, path):
    with one_line_error(StoreError, "expected a store, there is no such file"):
        Store.open(file_url(path), "run-1", create=False)
    assert list(tmp_path.iterdir()) == []


SHARED = 0x40000002, 510
"""Where SQLite locks a database that is open: first byte, and number of bytes."""


def test_opening_a_store_does_not_end_the_locks_of_another_connection(store, path):
    """Closing a descriptor of the file would end all locks that this process has on it."""
    store.add([row(cells()[0], 0)])
    code = "import fcntl, sys; fcntl.lockf(open(sys.argv[1], 'r+b'), fcntl.LOCK_EX | fcntl.LOCK_NB, {1}, {0})"
    lock = [sys.executable, "-c", code.format(*SHARED), path]
    assert b"BlockingIOError" in subprocess.run(lock, capture_output=True, check=False).stderr
    Store.open(file_url(path), "run-1", create=False).close()
    assert b"BlockingIOError" in subprocess.run(lock, capture_output=True, check=False).stderr


@pytest.mark.parametrize("value", [2**63, "\ud800"])
def test_a_value_that_no_database_holds_is_an_error_of_one_line(store, value):
    with one_line_error(UnstorableValue):
        store.add([row(cells()[0], 0, steps=value)])
    assert list(store.results()) == []


@pytest.mark.parametrize(
    "url",
    [
        "mysql://me:geheim@host/db",
        "postgresql+psycopg://127.0.0.1:1/db?user=u&password=geheim",
        "postgresql+psycopg://127.0.0.1:1/db?user=u&sslpassword=geheim&password=geheim",
        "postgresql+psycopg://127.0.0.1:1/db?PassWord=geheim",
        "postgresql+psycopg://me:geheim@127.0.0.1:x/db",
        "postgresql+psycopg://me:geheim@127.0.0.1:99999999/db",
        "postgresql+unknown://me:geheim@host/db",
        "me:geheim@host/db",
        "host=127.0.0.1 password=geheim",
    ],
)
def test_a_password_is_never_shown(url):
    with one_line_error(StoreError, "expected|connect|port|load") as raised:
        Store.open(url, "run-1")
    assert "geheim" not in str(raised.value)


def test_a_url_is_kept_without_its_passwords():
    url = "postgresql+psycopg://me:geheim@h:5432/db?sslkey=/k&password=geheim&sslmode=require"
    assert without_password(url) == "postgresql+psycopg://me:***@h:5432/db?password=***&sslkey=***&sslmode=require"


def test_the_url_of_a_file_is_absolute_if_the_file_is(path):
    assert file_url(path) == f"sqlite:///{path}"


def test_the_rows_of_an_ended_run_are_missed(tmp_path):
    played = rows(planned=1)
    run = document(1, rows_hash=rows_hash(map(outcome_row, played)))
    folder = run_folder(tmp_path / "run", run, played)
    Store.open_begun(folder, run).close()
    execute(folder / "episodes.sqlite", "DELETE FROM episodes")
    with one_line_error(StoreError, "it has none; restore it from a copy"):
        Store.open_begun(folder, run)
    nothing = document(1, rows_hash=rows_hash([]))
    Store.open_begun(folder, nothing).close()


def test_without_the_driver_of_postgresql_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(StoreError, match=r"not installed \(no module psycopg\); .*robogauntlet\[postgresql\]"):
        Store.open("postgresql+psycopg://127.0.0.1:1/db", "run")
