"""The verbs of the command `robogauntlet`. Each is one file, which is imported when the verb is used."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

VERBS = {
    "run": ("run:run", "Run a suite, or continue a run, and write its report."),
    "resume": ("resume:resume", "Continue a run of yours: play its missing episodes as it was begun."),
    "plan": ("plan:plan", "Show the episodes that a suite plans, without starting anything."),
    "validate": ("validate:validate", "Check suite files and report every mistake with its line."),
    "list": ("list:list_names", "List simulators, tasks, policies, shipped suites, or the episodes of a run."),
    "doctor": ("doctor:doctor", "Check that the installed simulators open and render on this machine."),
    "search": (
        "search:search",
        "Find the smallest disturbance that breaks a policy, along each axis and combined, and confirm it.",
    ),
    "profile": (
        "profile:profile",
        "Show how far an episode in each simulator is from its bound: physics, frames and answers.",
    ),
    "report": ("report:report", "Write the report of a run again."),
    "cite": ("cite:cite", "Print BibTeX of RoboGauntlet, and of the suite and the simulators of a run."),
    "replay": ("replay:replay_episode", "Replay a stored episode, compare it with its row and record a video."),
    "verify": ("verify:verify", "Check the rows of a run against their hash and replay a sample of its episodes."),
    "compare": (
        "compare:compare",
        "Compare two policies, all policies of a run or of a suite, or a run with its baseline, episode by episode.",
    ),
    "bisect": (
        "bisect:bisect",
        "Find the first checkpoint that is worse than --good by at least half of its difference to --bad.",
    ),
    "history": ("history:history", "List runs, or show the success of a policy over its runs."),
    "forget": ("forget:forget", "Remove a run from the history."),
    "export": ("export:export", "Write a run, or its rows, as one file, or its episodes as datasets."),
    "import": ("import_run:import_run", "Create a run folder from an exported run, to report and compare its rows."),
    "log": ("log:log", "Send the results of a run to an experiment tracker."),
    "serve": ("serve:serve", "Serve the dashboard."),
    "schedule": ("schedule:app", "Run suites at given times."),
    "axes": ("axes:app", "List perturbation axes and render their severities."),
    "env": ("env:app", "Create and check Python environments for simulators."),
    "adapters": ("adapters:app", "List, create and check simulator adapters."),
    "policies": ("policies:app", "Create, check and serve policies, and record demonstrations."),
}
"""Verb to its function or group (`module:name`) and its help; the docstring of a function begins with the same line."""


_tracebacks: list[bool] = []
"""Whether the command line asks for tracebacks; empty until it is read."""


class _Verbs(TyperGroup):
    """Imports the file of a verb only when the verb is used, so that `robogauntlet --help` stays fast.

    Verbs of other distributions come after those of this one.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands = {name: TyperCommand(name) for name in VERBS}  # for "Did you mean" only

    def list_commands(self, ctx: Any) -> list[str]:
        return [*_all_verbs()]  # `list` is a module here once that verb was imported

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in VERBS or cmd_name in _all_verbs():
            return _command(cmd_name)
        self.commands.update({name: TyperCommand(name) for name in _all_verbs()})
        return None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, help_line) for name, (_, help_line) in _all_verbs().items()])


def _all_verbs() -> Mapping[str, tuple[str, str]]:
    """Those of this distribution, and those of others with their modules' full names."""
    from robogauntlet.orchestrator.cli.plugin_verbs import plugin_verbs

    return {**VERBS, **{name: verb for name, verb in plugin_verbs().items() if name not in VERBS}}


@cache
def _command(name: str) -> Any:
    """The command, or group of commands, of a verb."""
    from robogauntlet.orchestrator.cli.parameters import check_parameters

    address, help_line = VERBS.get(name) or _all_verbs()[name]
    module, _, function = address.partition(":")
    verb = getattr(import_module(f"{__package__}.{module}" if name in VERBS else module), function)
    parent = typer.Typer(rich_markup_mode=None)
    if isinstance(verb, typer.Typer):
        parent.add_typer(verb, name=name, help=help_line)
    else:
        parent.command(name)(verb)
    return check_parameters(get_group(parent).commands[name])


app = typer.Typer(
    name="robogauntlet",
    cls=_Verbs,
    help="Evaluate robot policies across simulators.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(requested: bool) -> None:
    if requested:
        from robogauntlet import __version__

        print(f"robogauntlet {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    ctx: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but problems.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print the traceback of an error, too.")] = False,
) -> None:
    if ctx.invoked_subcommand is not None:
        from robogauntlet.orchestrator.cli.common import out
        from robogauntlet.orchestrator.cli.defaults import configured_defaults

        out.quiet = quiet
        _tracebacks.append(verbose)
        ctx.default_map = configured_defaults(ctx.command, ctx.invoked_subcommand)


def run_command() -> None:
    """Carry out the command line of this process; see `main`."""
    _tracebacks.clear()
    asks_for_help = sys.argv[1:2] == ["help"]  # `help run` for `run --help`
    try:
        app(args=[*sys.argv[2:], "--help"] if asks_for_help else None)
    except Exception as error:
        from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT, INPUT_ERRORS, fail

        if not isinstance(error, INPUT_ERRORS):
            raise
        if any(_tracebacks):
            traceback.print_exc()
        fail(str(error))
        sys.exit(EXIT_BAD_INPUT)
