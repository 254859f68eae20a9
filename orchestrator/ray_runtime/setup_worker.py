"""Stands in for the script with which Ray sets a worker's environment up: that imports Ray, and the worker once more.

A script of its own, which imports nothing that takes time. Its options and effects are those of Ray's, for workers in
Python on Linux.
"""

import json
import os
import re
import shlex
import sys
from collections.abc import Mapping, Sequence

CONTEXT, LANGUAGE = "--serialized-runtime-env-context=", "--language="


def set_variables(variables: Mapping[str, str]) -> None:
    """Set environment variables, in whose values `${NAME}` is another's value, or nothing."""
    for name, value in variables.items():
        os.environ[name] = re.sub(r"\$\{[A-Z0-9_]+\}", "", os.path.expandvars(value))


def become_worker(arguments: Sequence[str]) -> None:
    """Replace this process by the worker of these arguments, of which those two options are not its own."""
    context = json.loads(next((word.removeprefix(CONTEXT) for word in arguments if word.startswith(CONTEXT)), "{}"))
    script, *words = (word for word in arguments if not word.startswith((CONTEXT, LANGUAGE)))
    set_variables(context.get("env_vars") or {})
    script = context.get("override_worker_entrypoint") or script
    command = ["exec", context.get("py_executable") or sys.executable, *map(shlex.quote, (script, *words))]
    os.execvp("bash", ["bash", "-c", " ".join([*(context.get("command_prefix") or ()), *command])])


if __name__ == "__main__":
    become_worker(sys.argv[1:])
