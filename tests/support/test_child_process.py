"""Child processes answer in lines of JSON; how they end or hang is an exception in one line."""

import os
import sys
import time

import psutil
import pytest

from robogauntlet.support import child_process
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild

SERVE = "from robogauntlet.support.child_process import serve\nprint('not an answer')\n"


def child(code, **options):
    return JsonChild([sys.executable, "-c", code], **options)


def test_every_request_has_its_answer_whatever_is_printed():
    with child(SERVE + "serve(lambda request: [print('x'), request])") as echo:
        for request in ({"a": 1}, None, "é\n", "x" * 500_000):
            assert echo.ask(request, 20.0) == [None, request]
        assert echo.alive


@pytest.mark.parametrize(
    ("code", "how"),
    [
        ("raise ValueError('no luck')", "the process ended with code 1: ValueError: no luck"),
        ("raise SystemExit(3)", "the process ended with code 3: no message"),
        ("import os; os.kill(os.getpid(), 9)", "the process was killed by SIGKILL: no message"),
    ],
)
def test_the_error_says_how_the_process_ended(code, how):
    with child(code) as ending, pytest.raises(ChildEnded) as caught:
        ending.ask("x" * 500_000, 20.0)
    assert str(caught.value) == how


def test_a_process_that_does_not_answer_is_left_running():
    with child("import time; time.sleep(60)") as hanging:
        with pytest.raises(ChildTimeout, match=r"did not answer within 0\.2 s"):
            hanging.ask(None, 0.2)
        assert hanging.alive
    assert not hanging.alive


def test_a_process_may_end_by_itself_before_it_is_killed(tmp_path):
    polite = child(SERVE + f"serve(id)\nopen({str(tmp_path / 'closed')!r}, 'w')")
    polite.close(grace_s=20.0)
    polite.close()
    assert (tmp_path / "closed").exists()


def test_the_process_group_ends_with_the_process():
    code = "import subprocess\np = subprocess.Popen(['sleep', '60'])\n" + SERVE + "serve(lambda request: p.pid)"
    with child(code, own_group=True) as parent:
        grandchild = psutil.Process(parent.ask(None, 20.0))
    deadline = time.monotonic() + 10
    while grandchild.is_running() and grandchild.status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_failed_start_is_an_oserror_and_leaves_no_descriptor():
    before = psutil.Process(os.getpid()).num_fds()
    with pytest.raises(FileNotFoundError):
        JsonChild(["/nowhere/python"])
    with child("pass"):
        pass
    assert psutil.Process(os.getpid()).num_fds() == before


@pytest.mark.parametrize(
    ("code", "how"),
    [
        ("os.write(fd, b'no JSON\\n'); time.sleep(60)", "expected an answer in JSON, the process sent 'no JSON'"),
        ("os.write(fd, b'[' * 50_000 + b'\\n'); time.sleep(60)", "expected an answer in JSON, the process sent '[[["),
        ("while True: os.write(fd, b'1' * 65_536)", "expected an answer of 1 MiB at most, the process sent more"),
    ],
)
def test_an_answer_that_is_no_json_or_too_long_ends_the_process(code, how, monkeypatch):
    monkeypatch.setattr(child_process, "MAX_ANSWER_BYTES", 2**20)
    with child(f"import os, sys, time; fd = int(sys.argv[-1])\n{code}") as hostile:
        with pytest.raises(ChildEnded) as caught:
            hostile.receive(20.0)
        assert str(caught.value).startswith(how)
        assert not hostile.alive


@pytest.mark.parametrize(
    "code", ["os.write(fd, b'{'); time.sleep(60)", "while True: os.write(fd, b' '); time.sleep(0.01)"]
)
def test_the_deadline_holds_after_the_first_byte(code):
    with child(f"import os, sys, time; fd = int(sys.argv[-1])\n{code}") as slow, pytest.raises(ChildTimeout):
        slow.receive(1.5)


def test_a_process_that_reads_nothing_does_not_block_its_parent():
    with child("import time; time.sleep(60)") as deaf, pytest.raises(ChildTimeout, match=r"did not take its request"):
        deaf.ask("x" * 5_000_000, 0.5)


def test_a_child_does_not_look_for_modules_in_the_working_folder(tmp_path, monkeypatch):
    (tmp_path / "json.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    with JsonChild([sys.executable, "-c", "import json, os, sys; os.write(int(sys.argv[-1]), b'1\\n')"]) as child:
        assert child.receive(60.0) == 1
