"""`robogauntlet policies serve`: serve a policy to other processes in openpi's protocol."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from robogauntlet.orchestrator.cli.common import TOKEN, Host, Port, out, print_line
from robogauntlet.policies import catalog
from robogauntlet.policies.references import read_reference
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

if TYPE_CHECKING:
    from robogauntlet.orchestrator.inference.websocket_server import PolicyServer


def serve(
    policy: Annotated[
        str,
        typer.Argument(
            metavar="POLICY", help="Folder of a checkpoint, zoo:NAME, a kind of policy, or python:MODULE:NAME."
        ),
    ],
    option: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Option of the policy kind, in YAML. Repeatable.")
    ] = None,
    host: Host = "127.0.0.1",
    port: Port = 8000,
    task: Annotated[str, typer.Option(help="Task of clients that do not name one.")] = "unknown/unknown",
    batch: Annotated[
        int, typer.Option(min=1, max=1024, help="Largest number of queries, of several clients, in a batch.")
    ] = 1,
    wait_ms: Annotated[float, typer.Option(min=0, max=1000, help="Time to wait for a batch to fill (ms).")] = 2.0,
    most_mib: Annotated[int, typer.Option(min=1, max=1024, help="Largest size of a message (MiB).")] = 16,
) -> None:
    """Serve a policy over a websocket.

    Clients are suites (policy kind openpi), openpi's own clients, and robots.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    from robogauntlet.orchestrator.inference.websocket_server import (
        IdentifiedPolicy,
        PolicyServer,
        ServeError,
        ServerOptions,
    )

    place = ServerOptions(host, port, os.environ.get(TOKEN) or None, most_mib * 2**20, batch, wait_ms / 1000)
    try:
        place.check()
        kind, options = kind_and_options(policy, option or ())
        served = IdentifiedPolicy(catalog.load(kind, options), policy, catalog.digest(kind, options), task)
        asyncio.run(_until_stopped(PolicyServer(served, place)))
    except ServeError as error:
        raise BadInput(str(error)) from None
    out.print("stopped")


async def _until_stopped(server: PolicyServer) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    listening = await server.start()
    try:
        address, port = listening.sockets[0].getsockname()[:2]
        address = f"[{address}]" if ":" in address else address
        served = server.served
        print_line(f"serving {served.name} ({served.digest}) at ws://{address}:{port}; stop with Ctrl-C")
        await stop.wait()
    finally:
        listening.close()
        await listening.wait_closed()
        server.close()


def kind_and_options(text: str, options: Sequence[str]) -> tuple[str, Mapping[str, Any]]:
    """Return the kind and the options of a policy.

    Raises:
        BadInput: There is no such policy, or an option is not NAME=VALUE or unknown to its kind.
        PolicyError: The zoo has no such checkpoint.
    """
    entry = read_reference(text)
    kind, values = entry.kind, entry.options
    known = catalog.find(kind).options
    for given in options:
        name, sign, value = given.partition("=")
        if not sign or name not in known:
            hint = did_you_mean(name, known)
            raise BadInput(f"--option: expected NAME=VALUE with an option of '{kind}', got '{given}'{hint}")
        try:
            values = {**values, name: yaml.safe_load(value)}
        except yaml.YAMLError:
            raise BadInput(f"--option {name}: expected YAML, got '{value}'") from None
    return kind, values
