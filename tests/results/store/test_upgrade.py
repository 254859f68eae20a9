"""Stores of version 1, in files and on a PostgreSQL server, are upgraded when they are opened."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from itertools import count

import psycopg
import pytest
import sqlalchemy as sa

from robogauntlet.results.record import FIELDS, outcome_row, rows_hash
from robogauntlet.results.store.database import Database
from robogauntlet.results.store.episode_store import Store, StoreError, file_url
from robogauntlet.results.store.run_history import History
from robogauntlet.results.store.schema import SCHEMA, VERSION, metadata
from tests.errors import one_line_error
from tests.processes import environment_of
from tests.results.store.earlier import LATER, insert, make_store, rows_of
from tests.results.store.test_postgresql import server  # noqa: F401
from tests.results.synthetic import cells, document, execute, row, rows, run_folder

ROWS = rows(planned=3, errors=1)
HASH = "f273f4cf173fdee0"
"""Of `ROWS`, as version 1 computed it."""
MEASURED = {"path_length": 1.25, "gripper_openings": 2, "failure": "dropped"}
names = map("upgraded_{}".format, count())


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)])
def empty(request, tmp_path):
    """Makes addresses of empty databases."""
    if request.param == "sqlite":
        return lambda: file_url(tmp_path / f"{next(names)}.sqlite")
    address = sa.make_url(request.getfixturevalue("server"))

    def create():
        name = next(names)
        with psycopg.connect(
            address.set(drivername="postgresql").render_as_string(False), autocommit=True
        ) as connection:
            connection.execute(f"CREATE DATABASE {name}")
        return address.set(database=name).render_as_string(hide_password=False)

    return create


@pytest.fixture
def url(empty):
    """The address of a store of version 1 with `ROWS`."""
    address = empty()
    make_store(address, ROWS)
    return address


def stored(url, *, create=False):
    with closing(Store.open(url, "run-1", create=create)) as store:
        return sorted(store.results(), key=lambda result: result.episode_id)


def versions_of(url):
    """What a store says its version is, and the columns of its episodes."""
    engine = sa.create_engine(url)
    with engine.connect() as connection:
        found = connection.exec_driver_sql("SELECT version FROM robogauntlet_schema").scalars().all()
        columns = {column["name"] for column in sa.inspect(connection).get_columns("episodes")}
    engine.dispose()
    return found, columns


OLD = ([1], {"run_id", *FIELDS} - set(LATER))
NEW = ([VERSION], {"run_id", *FIELDS})


@pytest.mark.parametrize("create", [False, True])
def test_a_store_of_version_1_keeps_its_rows_and_their_hash(url, create):
    assert versions_of(url) == OLD
    found = stored(url, create=create)
    assert found == sorted(ROWS, key=lambda result: result.episode_id)
    assert rows_hash(map(outcome_row, found)) == HASH
    assert versions_of(url) == NEW
    assert stored(url, create=create) == found


@pytest.mark.parametrize("version", [2, 3])
def test_a_store_of_a_later_version_keeps_its_rows_with_their_behaviour_and_their_hash(empty, version):
    make_store(url := empty(), results := [*ROWS, row(cells()[0], 99, "failure", **MEASURED)], version=version)
    found = stored(url)
    assert found == sorted(results, key=lambda result: result.episode_id)
    assert rows_hash(map(outcome_row, found)) == rows_hash(map(outcome_row, results))
    assert versions_of(url) == NEW


def test_an_upgraded_store_has_all_tables_and_indexes(url):
    with closing(History.open(url)) as history:
        (entry,) = history.runs()
        inspector = sa.inspect(history.database.engine)
        for table in metadata.sorted_tables:
            assert {column["name"] for column in inspector.get_columns(table.name)} == set(table.columns.keys())
            assert {index["name"] for index in inspector.get_indexes(table.name)} >= {i.name for i in table.indexes}
        (judged,) = (i for i in inspector.get_indexes("runs") if i["name"] == "robogauntlet_runs_judged")
        assert "verdict IS NOT NULL" in "".join(map(str, judged["dialect_options"].values()))
    assert (entry.run_id, entry.accepted) == ("run-1", True)


def test_an_upgraded_store_takes_rows_whose_behaviour_was_measured(url):
    later = row(cells()[0], 99, "failure", **MEASURED)
    with closing(Store.open(url, "run-1", create=False)) as store:
        assert store.add([later]) == 1
        assert store.find(later.episode_id) == later
        assert rows_hash(map(outcome_row, store.results())) == rows_hash(map(outcome_row, [*ROWS, later]))


def test_several_may_create_a_store_at_the_same_time(empty):
    with ThreadPoolExecutor(4) as threads:
        for _ in range(5):
            url = empty()
            assert list(threads.map(partial(stored, create=True), [url] * 4)) == [[]] * 4
            assert versions_of(url) == NEW


def test_several_may_open_a_store_of_version_1_at_the_same_time(empty):
    with ThreadPoolExecutor(4) as threads:
        for _ in range(5):
            make_store(url := empty(), ROWS)
            found = list(threads.map(stored, [url] * 4))
            assert all(rows_hash(map(outcome_row, results)) == HASH for results in found)
            assert versions_of(url) == NEW


OPEN = """
import sys
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.store.episode_store import Store
print("ready", flush=True)
sys.stdin.readline()
print(rows_hash(map(outcome_row, Store.open(sys.argv[1], "run-1", create=False).results())))
"""


def begin(code, *arguments):
    """Starts a process of Python."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen(command, text=True, env=environment_of(), **pipes)


def test_several_processes_may_open_a_store_of_version_1_at_the_same_time(url):
    processes = [begin(OPEN, url) for _ in range(3)]
    assert [process.stdout.readline() for process in processes] == ["ready\n"] * 3
    for process in processes:
        process.stdin.write("\n")
        process.stdin.flush()
    assert [process.communicate(timeout=60) for process in processes] == [(f"{HASH}\n", "")] * 3
    assert versions_of(url) == NEW


DIE = """
import os, signal, sys
import sqlalchemy as sa
from robogauntlet.results.store.episode_store import Store

def die(connection, cursor, statement, *rest):
    if statement.startswith(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

sa.event.listen(sa.Engine, "after_cursor_execute", die)
Store.open(sys.argv[1], "run-1", create=False)
"""


@pytest.mark.parametrize("moment", ["ALTER TABLE episodes ADD COLUMN progress", "INSERT INTO robogauntlet_schema"])
def test_an_upgrade_that_is_killed_leaves_the_store_as_it_was(url, moment):
    process = begin(DIE, url, moment)
    _, complaints = process.communicate(timeout=60)
    assert process.returncode == -9, complaints
    assert versions_of(url) == OLD
    assert rows_hash(map(outcome_row, stored(url))) == HASH


def test_a_process_of_version_1_that_has_the_store_open_goes_on_writing(url):
    earlier, later = sa.create_engine(url), row(cells()[0], 99)
    with earlier.connect() as connection:
        assert connection.exec_driver_sql("SELECT count(*) FROM episodes").scalar() == len(ROWS)
    assert len(stored(url)) == len(ROWS)
    insert(earlier, "episodes", rows_of([later]))
    earlier.dispose()
    assert later in stored(url)


def test_a_store_of_version_1_whose_creation_was_cut_short_is_completed(url):
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        connection.exec_driver_sql("DELETE FROM robogauntlet_schema")
        connection.exec_driver_sql("DROP TABLE imported_runs")
    engine.dispose()
    assert len(stored(url, create=True)) == len(ROWS)
    assert versions_of(url) == NEW


def test_a_store_that_a_later_version_upgrades_meanwhile_is_refused_and_unchanged(url, monkeypatch):
    def overtaken(database, connection, name):
        other = sa.create_engine(url)
        with other.begin() as first:
            first.exec_driver_sql("UPDATE robogauntlet_schema SET version = 99")
        other.dispose()

    monkeypatch.setattr(Database, "_wait_for_others", overtaken)
    with one_line_error(StoreError, f"expected a store of version {VERSION}, got version 99"):
        stored(url)
    assert versions_of(url) == ([99], OLD[1])


def test_a_store_of_version_1_that_cannot_be_written_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "episodes.sqlite"
    make_store(file_url(path), ROWS)
    before = path.read_bytes()
    upgrading = f"upgrading it from version 1 to {VERSION}"
    words = f"{upgrading}: expected a store in a place that can be written, which reading takes too"
    with one_line_error(StoreError, words):
        stored(f"sqlite:///file:{path}?mode=ro&uri=true")
    assert path.read_bytes() == before


@pytest.mark.parametrize("empty", [pytest.param("postgresql", marks=pytest.mark.slow)], indirect=True)
def test_a_user_who_may_not_change_the_tables_is_told_that_they_need_an_upgrade(url):
    engine, reader = sa.create_engine(url), next(names)
    with engine.begin() as connection:
        connection.exec_driver_sql(f"CREATE USER {reader}")
        connection.exec_driver_sql(f"GRANT SELECT, INSERT, UPDATE, DELETE ON ALL TABLES IN SCHEMA public TO {reader}")
        connection.exec_driver_sql(f"GRANT ALL ON SCHEMA public TO {reader}")
    engine.dispose()
    theirs = sa.make_url(url).set(username=reader).render_as_string(hide_password=False)
    with one_line_error(StoreError, f"upgrading it from version 1 to {VERSION}: must be owner of table"):
        stored(theirs)
    assert versions_of(url) == OLD
    assert len(stored(url)) == len(stored(theirs)) == len(ROWS)


def test_what_a_person_added_to_a_store_of_version_1_stays(tmp_path):
    path = tmp_path / "episodes.sqlite"
    make_store(file_url(path), ROWS)
    execute(path, "CREATE VIEW mine AS SELECT * FROM episodes", "ALTER TABLE episodes ADD COLUMN note TEXT")
    assert len(stored(file_url(path))) == len(ROWS)
    assert versions_of(file_url(path)) == (NEW[0], {*NEW[1], "note"})


def test_the_run_of_a_folder_of_version_1_has_its_rows(tmp_path):
    run = document(3, rows_hash=HASH)
    folder = run_folder(tmp_path / "run", run, [])
    (folder / "episodes.sqlite").unlink()
    make_store(file_url(folder / "episodes.sqlite"), ROWS)
    with closing(Store.open_begun(folder, run)) as store:
        assert rows_hash(map(outcome_row, store.results())) == run.rows_hash


def test_the_columns_that_came_later_may_be_null():
    assert set(range(1, VERSION)) == SCHEMA.earlier
    assert all(metadata.tables["episodes"].c[name].nullable for name in LATER)
