"""Defaults of options, from the user's configuration file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robogauntlet.orchestrator.environments.environment import config_path, read_config
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput


def configured_defaults(group: Any, verb: str) -> dict[str, Any]:
    """Return the configured values of a verb's parameters, as click's `default_map` has them.

    Args:
        group: The click group of all verbs.
        verb: The verb that is called; of the others only the names are checked.

    Raises:
        BadInput: The file names a verb or an option that does not exist.
        SuiteError: The file is invalid.
    """
    defaults = read_config().defaults
    for name in defaults:
        if name not in group.commands:
            raise BadInput(f"{config_path()}: defaults: no verb '{name}'{did_you_mean(name, group.commands)}")
    return {verb: _by_parameter(group.get_command(None, verb), defaults[verb], verb)} if verb in defaults else {}


def _by_parameter(command: Any, given: Mapping[str, Any], place: str) -> dict[str, Any]:
    """Replace names of options by those of their parameters, below the verbs of a group, too."""
    verbs = getattr(command, "commands", None)
    options = {name.removeprefix("--"): option.name for option in command.params for name in option.opts}
    found = {}
    for name, value in given.items():
        if name not in (known := options if verbs is None else verbs):
            raise BadInput(f"{config_path()}: defaults: '{place}' has no '{name}'{did_you_mean(name, known)}")
        if verbs is None:
            found[options[name]] = value
        elif isinstance(value, Mapping):
            found[name] = _by_parameter(verbs[name], value, f"{place} {name}")
        else:
            raise BadInput(f"{config_path()}: defaults: expected options of '{place} {name}', got {value!r}")
    return found
