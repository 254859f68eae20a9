"""A file that is too much for SQLite or for the parser of documents ends a process of its own, with one line."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import psutil
import pytest

from robogauntlet.results.run_document import RunError
from robogauntlet.results.store import limited_reader
from robogauntlet.results.store.exported_file import LONGEST_TEXT, reading_time_s
from robogauntlet.results.store.run_archive import import_run
from tests.errors import one_line_error
from tests.processes import GAUNTLET, environment_of, started_by
from tests.results.store.test_exported_file import RESULTS, export
from tests.results.synthetic import cells, row


def refuse(file, match):
    """Expects that the file is refused in one line, and that neither files nor a process are left."""
    root = file.parent / "there"
    with one_line_error(RunError, match) as caught:
        import_run(file, root)
    assert str(caught.value).startswith(f"{file}: expected an exported run (`robogauntlet export`), ")
    assert not root.exists()
    assert readers() == []


def readers():
    """Processes of this one that read a run."""
    return started_by(psutil.Process(), "limited_reader")


def instead(monkeypatch, code):
    """Start a process of this code instead, which has the request as `request`."""
    code = f"import json, os, signal, sys, time\nrequest = json.loads(sys.stdin.readline())\n{code}"
    monkeypatch.setattr(limited_reader, "COMMAND", (sys.executable, "-c", code))


def with_plan(file, plan):
    """Give the run another plan, as JSON."""
    with closing(sqlite3.connect(file)) as connection, connection:
        text = json.loads(connection.execute("SELECT document FROM runs").fetchone()[0])
        text = json.dumps({**text, "plan": "HERE"}).replace('"HERE"', plan)
        connection.execute("UPDATE runs SET document = ?", [text])
    return file


def test_a_document_that_needs_too_much_memory_is_refused(tmp_path):
    """Each of five million empty cells has seven mistakes; to list them all took more than 8 GB."""
    refuse(with_plan(export(tmp_path), f"[{','.join(['{}'] * 5_000_000)}]"), "reading it takes too much memory")


def test_python_that_needs_too_much_memory_is_refused(tmp_path, monkeypatch):
    instead(
        monkeypatch,
        "from robogauntlet.results.store.limited_reader import limit_this_process\n"
        "limit_this_process(request['limits'])\n"
        "bytearray(4 * 2**30)",
    )
    refuse(export(tmp_path), "reading it takes too much memory")


def test_endless_work_in_code_of_c_ends_at_the_limit_of_time(tmp_path, monkeypatch):
    instead(
        monkeypatch,
        "from robogauntlet.results.store.limited_reader import limit_this_process\n"
        "limit_this_process({'RLIMIT_CPU': 1})\n"
        "sum(iter(int, 1))",
    )
    refuse(export(tmp_path), "reading it takes too long")


def test_a_process_that_waits_for_ever_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(limited_reader, "START_S", 1.0 - reading_time_s(0))
    instead(monkeypatch, "time.sleep(600) # limited_reader")
    began = time.monotonic()
    refuse(export(tmp_path), "reading it takes too long")
    assert time.monotonic() - began < 30


def test_endless_output_ends_at_the_limit_of_a_files_size(tmp_path, monkeypatch):
    file = export(tmp_path)
    monkeypatch.setattr(limited_reader, "WRITTEN", 8_000)
    monkeypatch.setattr(limited_reader, "WRITTEN_PER_BYTE", 0)
    refuse(file, "reading it writes too much")


def test_an_endless_answer_is_refused(tmp_path, monkeypatch):
    instead(monkeypatch, "while True: os.write(int(sys.argv[-1]), bytes(1 << 16))")
    refuse(export(tmp_path), "it cannot be read: expected an answer of 64 MiB at most")


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGABRT, signal.SIGKILL], ids=lambda number: number.name)
def test_a_process_that_is_killed_is_one_line_with_its_signal(tmp_path, monkeypatch, number):
    instead(monkeypatch, f"os.kill(os.getpid(), {number:d})")
    refuse(export(tmp_path), f"it cannot be read: the process was killed by {number.name}$")


def test_an_unforeseen_error_is_one_line_without_the_senders_text(tmp_path, monkeypatch):
    instead(monkeypatch, "raise TypeError('text of the sender')")
    refuse(export(tmp_path), "it cannot be read: the process ended with code 1$")


def test_a_full_disk_is_an_error_of_the_system(tmp_path, monkeypatch):
    instead(monkeypatch, 'os.write(int(sys.argv[-1]), b\'{"OSError": [28, "No space left on device", "x"]}\\n\')')
    with pytest.raises(OSError, match="No space left on device") as caught:
        import_run(export(tmp_path), tmp_path / "there")
    assert (caught.value.errno, caught.value.filename) == (28, "x")
    assert not (tmp_path / "there").exists()


def test_the_process_gets_no_secrets(tmp_path, monkeypatch):
    seen = tmp_path / "seen"
    for name in ("ROBOGAUNTLET_TOKEN", "ROBOGAUNTLET_HISTORY", "PGPASSWORD", "ROBOGAUNTLET_POLICY_TOKEN_LAB"):
        monkeypatch.setenv(name, "s3cret")
    instead(monkeypatch, f"open({str(seen)!r}, 'w').write(repr(dict(os.environ)))")
    refuse(export(tmp_path), "it cannot be read")
    assert "PATH" in seen.read_text()
    assert "s3cret" not in seen.read_text()


def test_the_process_has_the_limits_that_it_is_given_and_raises_none():
    limits = {**limited_reader._limits(1000), "RLIMIT_NOFILE": 32}
    code = (
        "import json, resource, sys\n"
        "from robogauntlet.results.store.limited_reader import limit_this_process\n"
        "limits = json.loads(sys.argv[1])\n"
        "limit_this_process(limits)\n"
        "limit_this_process({name: 2 * most for name, most in limits.items()})\n"
        "print(json.dumps({name: resource.getrlimit(getattr(resource, name))[0] for name in limits}))"
    )
    done = subprocess.run([sys.executable, "-c", code, json.dumps(limits)], capture_output=True, check=True)
    assert json.loads(done.stdout) == limits


def test_memory_is_enough_for_the_largest_upload(tmp_path):
    """Rows are read in parts; what stays of each is a digest, which is smaller than the row."""
    digest, shortest_row = sys.getsizeof(bytes(32)) + 2 * 8, 300
    assert digest < limited_reader.MEMORY_PER_BYTE * shortest_row
    text = "\N{ROBOT FACE}".ljust(LONGEST_TEXT)  # of which each character takes 4 bytes in memory
    rows = [row(cell, seed, error=text) for cell in cells() for seed in range(limited_reader.BATCH // len(cells()) + 1)]
    import_run(export(tmp_path, rows), tmp_path / "there")


def test_the_process_starts_with_little():
    heavy = ("numpy", "pandas", "pyarrow", "scipy", "jinja2", "fastapi", "sqlalchemy.dialects.postgresql")
    code = f"import sys, {limited_reader.__name__}\nprint([name for name in {heavy!r} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_modules_of_the_current_folder_are_not_taken(tmp_path, monkeypatch):
    (tmp_path / "resource.py").write_text("raise SystemExit('a module of the sender')")
    monkeypatch.chdir(tmp_path)
    folder, _ = import_run(export(tmp_path), tmp_path / "there")
    assert (folder / "run.json").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_an_interrupted_import_leaves_neither_process_nor_files(tmp_path, number):
    file, began = export(tmp_path), tmp_path / "began"
    code = f"import time; open({str(began)!r}, 'w').close(); time.sleep(600)"
    script = (
        "import sys\nfrom robogauntlet.results.store import limited_reader\n"
        f"limited_reader.COMMAND = (sys.executable, '-c', {code!r}, 'limited_reader')\n"
    )
    command = [sys.executable, "-c", script + GAUNTLET[-1], "import", str(file), "--out", str(tmp_path / "new" / "run")]
    with subprocess.Popen(command, cwd=tmp_path, env=environment_of(), stderr=subprocess.PIPE, text=True) as process:
        while not began.exists():
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.05)
        (found,) = (child.pid for child in started_by(process, code))
        os.kill(process.pid, number)
        _, complaints = process.communicate(timeout=60)
    assert process.returncode not in (0, 2)
    assert "Traceback" not in complaints
    assert not psutil.pid_exists(found)
    assert not (tmp_path / "new").exists()


def test_the_rows_of_a_large_run_are_read_in_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(limited_reader, "BATCH", 7)
    with closing(limited_reader.Copier(export(tmp_path), tmp_path)) as copier:
        copier.copy_rows()
    with closing(sqlite3.connect(tmp_path / "episodes.sqlite")) as connection:
        assert connection.execute("SELECT count(*) FROM episodes").fetchone() == (len(RESULTS),)
