"""Nothing of a session is left, however the process that began it ends."""

import ast
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from robogauntlet.orchestrator.ray_runtime import session_folder
from tests.processes import GAUNTLET, run_process, started_by

WITHIN_S = 30.0
SUITE = "name: s\npolicies: [oracle]\ntasks: [null/Slow]\nseeds: {count: 200}\nworkers: 2\n"
LOOKED_AT = """
import os, subprocess, sys, ray
from pathlib import Path
from robogauntlet.orchestrator.ray_runtime.session import ray_session, temporary_folder

with ray_session(address=None, workers=1):
    root = temporary_folder().parent
    sockets = [str(path) for path in root.rglob("*") if path.is_socket()]
    assert sockets and max(map(len, sockets)) <= 107, sockets
    print(ray.get(ray.remote(lambda: [sys.path, os.getcwd()]).remote()))
    print(root)
    print(root.parent, oct(root.stat().st_mode & 0o777), root.stat().st_uid == os.getuid())
    (logs,) = root.glob("ray/session_2*/logs")
    other = {"user": 65534} if os.getuid() == 0 else {}
    done = subprocess.run(["ln", "-s", "/etc/passwd", logs], capture_output=True, text=True, check=False, **other)
    print(done.stderr.strip() or "linked")
"""

pytestmark = pytest.mark.ray


@pytest.fixture(scope="module")
def looked_at(tmp_path_factory):
    """What a session under a long TMPDIR prints.

    That is: where its workers look for modules, its folder, where that is and whose, and what another user can do.
    """
    long = tmp_path_factory.mktemp("job" + "x" * 60)
    (long / "looking.py").write_text(LOOKED_AT)
    done = run_process([sys.executable, "looking.py"], cwd=long, TMPDIR=str(long))
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-4:]


def test_workers_look_for_no_module_in_the_working_folder_or_that_of_the_script(looked_at):
    path, folder = ast.literal_eval(looked_at[0])
    assert folder not in path
    assert "" not in path


def test_the_folder_of_a_session_goes_with_it(looked_at):
    assert not Path(looked_at[1]).exists()


@pytest.mark.skipif(os.getuid() != 0, reason="this machine lets only root act as a second user")
def test_another_user_reaches_nothing_of_a_session_whatever_tmpdir_is_and_no_socket_is_too_long(looked_at):
    assert looked_at[2] == "/tmp 0o700 True"
    assert looked_at[3].endswith("Permission denied")


def test_half_a_minute_after_sigkill_nothing_of_a_run_is_left(tmp_path):
    (tmp_path / "suite.yaml").write_text(SUITE)
    command = psutil.Popen(
        [*GAUNTLET, "run", "suite.yaml", "--out", "run", "--no-media"], cwd=tmp_path, stdout=subprocess.DEVNULL
    )
    while not (workers := started_by(command, "Worker.play")):
        assert command.poll() is None
        time.sleep(0.1)
    temporary = Path(workers[0].environ()["TMPDIR"])
    assert temporary.is_dir()
    started = started_by(command)
    assert started_by(command, "raylet/raylet")
    command.send_signal(signal.SIGKILL)
    command.wait()
    deadline = time.monotonic() + WITHIN_S
    while time.monotonic() < deadline and (temporary.parent.exists() or any(map(psutil.Process.is_running, started))):
        time.sleep(0.2)
    assert not temporary.parent.exists()
    assert [child for child in started if child.is_running()] == []


def test_the_guard_of_a_process_that_is_just_being_killed_removes_the_folder(tmp_path):
    (tmp_path / "session").mkdir()
    code = "import os, sys; from pathlib import Path\n"
    code += f"from {session_folder.__name__} import guard\n"
    code += "parents = iter([7, 7, 7]); os.getppid = lambda: next(parents, 1)\n"
    code += "guard(Path(sys.argv[1]), 7)"
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "session")], stdin=subprocess.DEVNULL, check=True)
    assert not (tmp_path / "session").exists()


def test_the_guard_of_a_living_process_ends_and_removes_nothing(tmp_path):
    (tmp_path / "tmp").mkdir()
    guard = [sys.executable, "-m", session_folder.__name__, str(tmp_path), str(os.getpid())]
    with subprocess.Popen(guard, stdin=subprocess.PIPE) as process:
        process.communicate(timeout=60)
    assert process.returncode == 0
    assert (tmp_path / "tmp").is_dir()
