"""`robogauntlet policies`: create, check and serve policies, and record demonstrations."""

from __future__ import annotations

import typer

from robogauntlet.orchestrator.cli.policies import check, demonstrate, new, serve

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
app.command("new")(new.new)
app.command("check")(check.check)
app.command("demonstrate")(demonstrate.demonstrate)
app.command("serve")(serve.serve)
