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

Verbs = Mapping[str, tuple["str | Verbs", str]]
VERBS: Verbs = {
    "run": (".run:run", "Run a suite, or continue a run, and write its report."),
    "resume": (".resume:resume", "Continue a run of yours as it was begun."),
    "watch": (".watch:watch", "Evaluate each checkpoint of a training when it is written."),
    "plan": (".plan:plan", "Show the episodes of a suite, starting nothing, or check suites."),
    "report": (".report:report", "Write the report of a run again, or print its table or BibTeX."),
    "compare": (".compare:compare", "Compare policies, or a run with its baseline, episode by episode."),
    "replay": (".replay:replay", "Replay a stored episode and record a video, or verify a run."),
    "search": (
        {
            "disturbance": (".search.disturbance:search", "Find the smallest disturbance that breaks a policy."),
            "checkpoint": (".search.checkpoint:search", "Find the first checkpoint that became worse."),
        },
        "Find what breaks a policy, or the checkpoint that became worse.",
    ),
    "list": (
        {
            "simulators": (
                ".list.names:list_simulators",
                "List the simulators with their versions and numbers of tasks.",
            ),
            "tasks": (".list.names:list_tasks", "List the tasks of all simulators with their instructions."),
            "policies": (".list.names:list_policies", "List the kinds of policies, with the addresses of servers."),
            "suites": (".list.names:list_suites", "List the suites that are shipped."),
            "axes": (".list.axes:list_axes", "List the perturbation axes with their severities, or show one."),
            "runs": (".list.runs:list_runs", "List runs, or show the success of a policy over its runs."),
            "episodes": (
                ".list.episodes:list_episodes",
                "List the episodes of a run with the ids that `replay` takes.",
            ),
        },
        "List simulators, tasks, policies, suites, axes, runs or episodes.",
    ),
    "check": (
        {
            "installation": (".check.installation:check", "Check that the installed simulators open and render."),
            "adapter": (".check.adapter:check", "Check an adapter against its contract."),
            "policy": (".check.policy:check", "Play short episodes of a policy and say what its numbers do."),
        },
        "Check the installation, an adapter, or a policy.",
    ),
    "new": (
        {
            "adapter": (".new.adapter:new", "Create the package of a new adapter."),
            "policy": (".new.policy:new", "Create a folder with a policy, its tests and a suite."),
            "demonstrations": (".new.demonstrations:new", "Record successful episodes of the oracles as datasets."),
        },
        "Create an adapter or a policy, or record demonstrations.",
    ),
    "export": (".export:export", "Write a run as a file or table, or send it to a tracker."),
    "import": (".import_run:import_run", "Create a run folder from an exported run, or from result files of others."),
    "serve": (
        {
            "dashboard": (".serve.dashboard:serve", "Serve the dashboard."),
            "policy": (".serve.policy:serve", "Serve a policy over a websocket."),
        },
        "Serve the dashboard, or a policy.",
    ),
    "schedule": (".schedule:app", "Run suites at given times."),
    "env": (".env:app", "Create and check Python environments for simulators."),
}
"""Verb to its function or group (`module:name`), or to the verbs below it, and its help.

The docstring of a function begins with the same line.
"""


_tracebacks: list[bool] = []
"""Whether the command line asks for tracebacks; empty until it is read."""


class _Group(TyperGroup):
    """Imports the file of a verb only when the verb is used, so that `robogauntlet --help` stays fast."""

    def __init__(self, *, verbs: Verbs = VERBS, **options: Any) -> None:
        super().__init__(**options)
        self.show(verbs)

    def show(self, verbs: Verbs) -> None:
        """Have these verbs."""
        self.verbs = verbs
        self.commands = {name: TyperCommand(name=name) for name in verbs}  # for "Did you mean" only

    def list_commands(self, ctx: Any) -> list[str]:
        return [*self.verbs]  # `list` is a package here once a verb of it was imported

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.verbs:
            return None
        below, help_line = self.verbs[cmd_name]
        if isinstance(below, str):
            return _command(cmd_name, below, help_line)
        return _Group(verbs=below, name=cmd_name, help=help_line, no_args_is_help=True, rich_markup_mode=None)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        names = self.list_commands(ctx)
        with formatter.section("Commands"):
            formatter.write_dl([(name, self.verbs[name][1]) for name in names])


class _Verbs(_Group):
    """The verbs of this distribution, and after them those of others."""

    def list_commands(self, ctx: Any) -> list[str]:
        self._add_plugins()
        return super().list_commands(ctx)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.verbs:
            self._add_plugins()
        return super().get_command(ctx, cmd_name)

    def _add_plugins(self) -> None:
        from robogauntlet.orchestrator.cli.plugin_verbs import plugin_verbs

        self.show({**VERBS, **{name: verb for name, verb in plugin_verbs().items() if name not in VERBS}})


@cache
def _command(name: str, address: str, help_line: str) -> Any:
    """The command, or group of commands, of a verb."""
    from robogauntlet.orchestrator.cli.parameters import check_parameters

    module, _, function = address.partition(":")
    verb = getattr(import_module(module, __package__), function)
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

        out.quiet = quiet
        _tracebacks.append(verbose)


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
