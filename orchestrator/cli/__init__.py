"""The command `gauntlet`. One verb, one file."""

from __future__ import annotations

import signal
import sys
from types import FrameType

import typer

from orchestrator.cli import (
    adapters,
    axes,
    carry,
    compare,
    doctor,
    env,
    history,
    listing,
    log,
    plan,
    policies,
    profile,
    replay,
    report,
    run,
    schedule,
    serve,
    validate,
    verify,
)
from orchestrator.cli.shared import EXIT_BAD_INPUT, BadInput, fail

app = typer.Typer(
    name="gauntlet",
    help="Sends robot policies through a gauntlet of simulators.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("run")(run.run)
app.command("plan")(plan.plan)
app.command("validate")(validate.validate)
app.command("list")(listing.list_names)
app.command("doctor")(doctor.doctor)
app.command("report")(report.report)
app.command("replay")(replay.replay_episode)
app.command("verify")(verify.verify)
app.command("compare")(compare.compare)
app.command("gate")(compare.gate)
app.command("history")(history.history)
app.command("leaderboard")(history.show_leaderboard)
app.command("accept")(history.accept)
app.command("export")(carry.export)
app.command("import")(carry.take)
app.command("log")(log.log)
app.command("serve")(serve.serve)
app.command("profile")(profile.profile)
app.add_typer(schedule.app, name="schedule")
app.add_typer(axes.app, name="axes")
app.add_typer(env.app, name="env")
app.add_typer(
    adapters.app, name="adapters", help="Simulators: which there are, whether they keep the contract, new ones."
)
app.add_typer(policies.app, name="policies", help="Make policies: demonstrations, training, merging. Serve them.")


def main() -> None:
    """Entry point. Exit codes: 0 done, 1 something differs, 2 bad input, 3 stopped early, 130 interrupted."""
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        app()
    except BadInput as error:
        fail(str(error))
        sys.exit(EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(130)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
