"""Steps of a GitHub action and workflow, run as GitHub runs them, without GitHub."""

import os
import re
import subprocess
import sys
from pathlib import Path

import yaml

from tests import ROOT

SHELL = ("bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c")
"""What GitHub calls for `shell: bash`."""
INPUT = re.compile(r"\$\{\{ inputs\.([\w-]+) \}\}")


def load(name):
    """A YAML file of the repository. YAML reads the key `on` as true."""
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def action_steps():
    return {step["name"]: step for step in load("action.yml")["runs"]["steps"] if "run" in step}


class HostedRunner:
    """A runner of GitHub with the command `robogauntlet` and this repository as the place of the action.

    Args:
        folder: Working directory of every step.
        programs: Folder of programs that come before all others.
    """

    def __init__(self, folder: Path, programs: Path) -> None:
        self.folder = folder
        self.summary = folder / "summary.md"
        programs.mkdir(exist_ok=True)
        write_program(
            programs / "robogauntlet",
            f'exec {sys.executable} -c "from robogauntlet.orchestrator.cli import main; main()" "$@"',
        )
        self.environment = {
            **os.environ,
            "GITHUB_STEP_SUMMARY": str(self.summary),
            "GITHUB_ACTION_PATH": str(ROOT),
            "PATH": f"{programs}:{os.environ['PATH']}",
            "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}",
        }

    def run_step(self, name, **inputs):
        """Run one step of the action; returns exit code, output and the text that was added to the summary."""
        declared = load("action.yml")["inputs"]
        assert inputs.keys() <= declared.keys()
        values = {key: str(inputs.get(key, settings.get("default", ""))) for key, settings in declared.items()}
        step = action_steps()[name]
        variables = {key: INPUT.sub(lambda found: values[found[1]], text) for key, text in step["env"].items()}
        return self.run_script(step["run"], **variables)

    def run_script(self, script, **variables):
        self.summary.write_text("")
        done = subprocess.run(
            [*SHELL, script],
            cwd=self.folder,
            env={**self.environment, **variables},
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        return done.returncode, done.stdout + done.stderr, self.summary.read_text()


def write_program(path, script):
    path.write_text(f"#!/bin/bash\n{script}\n")
    path.chmod(0o755)
