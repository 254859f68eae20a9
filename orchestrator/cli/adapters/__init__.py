"""`gauntlet adapters`: which there are, whether they keep the contract, and the beginning of a new one."""

from __future__ import annotations

import typer

from orchestrator.cli.adapters import check, listing, new

app = typer.Typer(no_args_is_help=True)
app.command("list")(listing.list_adapters)
app.command("check")(check.check)
app.command("new")(new.new)
