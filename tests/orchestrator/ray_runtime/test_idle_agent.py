"""What stands in for the agent of Ray's dashboard."""

import subprocess
import sys
import time

import psutil

from robogauntlet.orchestrator.ray_runtime import idle_agent

RAY = """
import os, subprocess, sys
environment = {**os.environ, "RAY_RAYLET_PID": str(os.getpid())}
agent = subprocess.Popen([sys.executable, "-I", "-S", *sys.argv[1:]], env=environment)
print(agent.pid, flush=True)
input()
"""


def test_it_names_no_ports_and_ends_with_ray(tmp_path):
    command = [sys.executable, "-c", RAY, idle_agent.__file__, f"--session-dir={tmp_path}", "--node-id=ab", "--head"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as ray:
        agent = psutil.Process(int(ray.stdout.readline()))
        expected = {f"{port}_ab" for port in idle_agent.PORTS}
        wait_for(lambda: {path.name for path in tmp_path.iterdir()} == expected)
        assert {path.read_text() for path in tmp_path.iterdir()} == {"-1"}
        assert agent.is_running()
        ray.kill()
    wait_for(lambda: not agent.is_running())


def wait_for(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
