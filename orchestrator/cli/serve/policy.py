"""`robogauntlet serve policy`: serve a policy to other processes."""

from __future__ import annotations

import asyncio
import os
from typing import TYPE_CHECKING, Annotated

import typer

from robogauntlet.orchestrator.cli.common import TOKEN, Host, PolicyOptions, Port, out, print_line
from robogauntlet.policies import catalog
from robogauntlet.policies.references import FORMS, read_options, read_reference, with_options
from robogauntlet.policies.remote.server_options import WireProtocol
from robogauntlet.support.errors import BadInput
from robogauntlet.support.interrupts import SIGNALS

if TYPE_CHECKING:
    from robogauntlet.orchestrator.inference.websocket_server import PolicyServer


def serve(
    policy: Annotated[str, typer.Argument(metavar="POLICY", help=f"{FORMS}.")],
    option: PolicyOptions = None,
    host: Host = "127.0.0.1",
    port: Port = 8000,
    protocol: Annotated[WireProtocol, typer.Option(help="What clients speak.")] = WireProtocol.OPENPI,
    task: Annotated[str, typer.Option(help="Task of clients that do not name one.")] = "unknown/unknown",
    batch: Annotated[
        int, typer.Option(min=1, max=1024, help="Largest number of queries, of several clients, in a batch.")
    ] = 1,
    wait_ms: Annotated[float, typer.Option(min=0, max=1000, help="Time to wait for a batch to fill (ms).")] = 2.0,
    most_mib: Annotated[int, typer.Option(min=1, max=1024, help="Largest size of a message (MiB).")] = 16,
) -> None:
    """Serve a policy over a websocket.

    Clients are suites (policy kind openpi), openpi's own clients, and robots; or benchmarks of vla-evaluation-harness.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    from robogauntlet.orchestrator.inference.shared_policy import IdentifiedPolicy
    from robogauntlet.orchestrator.inference.websocket_server import PolicyServer, ServeError, ServerOptions

    token = os.environ.get(TOKEN) or None
    place = ServerOptions(host, port, token, most_mib * 2**20, batch, wait_ms / 1000, protocol)
    try:
        place.check()
        (entry,) = with_options([read_reference(policy)], read_options(option or ()))
        digest = catalog.digest(entry.kind, entry.options)
        execute = catalog.wishes(entry.kind, entry.options).execute
        served = IdentifiedPolicy(catalog.load(entry.kind, entry.options), policy, digest, task, execute)
        asyncio.run(_until_stopped(PolicyServer(served, place)))
    except ServeError as error:
        raise BadInput(str(error)) from None
    out.print("stopped")


async def _until_stopped(server: PolicyServer) -> None:
    stop = asyncio.Event()
    for number in SIGNALS:
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
