"""Stores as earlier versions wrote them, made by SQL."""

import sqlite3
from contextlib import closing

import sqlalchemy as sa

from robogauntlet.results.record import FIELDS
from robogauntlet.results.store.schema import columns_after
from tests import ROOT

SQL = {version: (ROOT / f"tests/data/store-{version}.sql").read_text() for version in (1, 2, 3, 4)}
"""Tables and indexes by version."""
LATER = columns_after(1)
"""Columns of `episodes` that version 1 did not have."""
RUN = {
    **{"run_id": "run-1", "started_at": 1.0, "document": "{}", "suite": "synthetic", "status": "complete"},
    **{"planned": 24, "accepted": True},
}


def insert(engine, table, rows):
    """Insert rows, mappings by column, into a table."""
    names = list(rows[0])
    statement = f"INSERT INTO {table} ({', '.join(names)}) VALUES ({', '.join(f':{name}' for name in names)})"
    with engine.begin() as connection:
        connection.execute(sa.text(statement), rows)


def rows_of(results, run_id="run-1", version=1):
    """Rows of `episodes` as a version had them."""
    names = [name for name in FIELDS if name not in columns_after(version)]
    return [{"run_id": run_id, **{name: getattr(result, name) for name in names}} for result in results]


def make_store(url, results, version=1):
    """Make a store of an earlier version with the run `run-1`."""
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        for statement in filter(str.strip, SQL[version].split(";")):
            connection.exec_driver_sql(statement)
    insert(engine, "robogauntlet_schema", [{"version": version}])
    insert(engine, "runs", [RUN])
    insert(engine, "episodes", rows_of(results, version=version))
    engine.dispose()


def as_version_1(file):
    """Replace a store in a file, which nobody has open, by one of version 1 with the same content."""
    earlier, log = file.with_name("earlier.sqlite"), file.read_bytes()[18] == 2
    with closing(sqlite3.connect(earlier)) as connection:
        connection.execute("ATTACH ? AS later", [str(file)])
        connection.executescript(SQL[1])
        for (table,) in connection.execute("SELECT name FROM main.sqlite_master WHERE type = 'table'").fetchall():
            names = ", ".join(name for _, name, *_ in connection.execute(f"PRAGMA main.table_info({table})"))
            connection.execute(f"INSERT INTO main.{table} SELECT {names} FROM later.{table}")
        connection.execute("UPDATE main.robogauntlet_schema SET version = 1")
        connection.commit()
        connection.execute("DETACH later")
        connection.execute(f"PRAGMA journal_mode = {'WAL' if log else 'DELETE'}")
    for path in file.parent.glob(f"{file.name}*"):
        path.unlink()
    earlier.replace(file)
    return file
