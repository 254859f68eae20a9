"""Stores as earlier versions wrote them, made by SQL."""

import sqlite3
from contextlib import closing

import sqlalchemy as sa

from robogauntlet.results.record import FIELDS, LATER
from tests import ROOT

SQL = {version: (ROOT / f"tests/data/store-{version}.sql").read_text() for version in (1, 2)}
"""Tables and indexes by version."""
FIELDS_1 = [name for name in FIELDS if name not in LATER]
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


def rows_1(results, run_id="run-1"):
    """Rows of `episodes` as version 1 had them."""
    return [{"run_id": run_id, **{name: getattr(result, name) for name in FIELDS_1}} for result in results]


def make_store_1(url, results):
    """Make a store of version 1 with the run `run-1`."""
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        for statement in filter(str.strip, SQL[1].split(";")):
            connection.exec_driver_sql(statement)
    insert(engine, "robogauntlet_schema", [{"version": 1}])
    insert(engine, "runs", [RUN])
    insert(engine, "episodes", rows_1(results))
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
