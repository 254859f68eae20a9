"""`gauntlet policies serve`: a policy for other processes, in openpi's protocol."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from orchestrator.cli.shared import BadInput, out
from policies import catalog, zoo
from policies.contract import PolicyError
from policies.mergevla.card import CARD, card_json
from policies.mergevla.merged_card import KIND as MERGED
from policies.mergevla.merged_policy import EXPERTS_NAME, MERGED_NAME
from suites.plugins import nearest
from suites.shorthand import policy_entry

if TYPE_CHECKING:
    from orchestrator.policy_server import PolicyServer

TOKEN = "GAUNTLET_TOKEN"


def serve(
    policy: Annotated[
        str,
        typer.Argument(metavar="POLICY", help="A checkpoint's folder, zoo:NAME, a kind of policy, python:MODULE:NAME."),
    ],
    option: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="An option of the kind, in YAML. Repeatable.")
    ] = None,
    host: Annotated[str, typer.Option(help=f"Address to listen on; another than loopback needs {TOKEN}.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 for any that is free.")] = 8000,
    task: Annotated[str, typer.Option(help="Task of clients that do not name theirs.")] = "unknown/unknown",
    batch: Annotated[int, typer.Option(min=1, max=1024, help="Queries of several clients in one batch at most.")] = 1,
    wait_ms: Annotated[float, typer.Option(min=0, max=1000, help="Time that a batch is waited for.")] = 2.0,
    most_mib: Annotated[int, typer.Option(min=1, max=1024, help="Size of a message at most (MiB).")] = 16,
) -> None:
    """Serve a policy over a websocket: for suites (kind openpi), openpi's own clients, and robots."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        from orchestrator.policy_server import Place, PolicyServer, Served, ServeError
    except ModuleNotFoundError as error:
        raise BadInput(f"expected the packages of robogauntlet[remote], found none named {error.name}") from None
    place = Place(host, port, os.environ.get(TOKEN) or None, most_mib * 2**20, batch, wait_ms / 1000)
    try:
        place.check()
        kind, options = named(policy, option or ())
        served = Served(catalog.load(kind, options), policy, catalog.digest(kind, options), task)
        asyncio.run(_until_stopped(PolicyServer(served, place)))
    except (PolicyError, ServeError) as error:
        raise BadInput(str(error)) from None
    out.print("ended")


async def _until_stopped(server: PolicyServer) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    listening = await server.start()
    try:
        address, port = listening.sockets[0].getsockname()[:2]
        address = f"[{address}]" if ":" in address else address
        served = server.served
        out.print(
            f"serving {served.name} ({served.digest}) at ws://{address}:{port}; Ctrl-C ends it",
            markup=False,
            soft_wrap=True,
        )
        await stop.wait()
    finally:
        listening.close()
        await listening.wait_closed()
        server.close()


def named(text: str, options: Sequence[str]) -> tuple[str, Mapping[str, Any]]:
    """Kind and options of the policy that is meant.

    Raises:
        BadInput: There is no such policy, or an option is not NAME=VALUE or none of its kind's.
        PolicyError: The zoo has no such checkpoint.
    """
    entry = policy_entry(text)
    if entry["kind"] in catalog.kinds():
        kind, own = entry["kind"], entry.get("options", {})
    else:
        kind, own = _checkpoint(text)
    known = catalog.find(kind).options
    for given in options:
        name, sign, value = given.partition("=")
        if not sign or name not in known:
            hint = nearest(name, known)
            raise BadInput(f"--option: expected NAME=VALUE with an option of '{kind}', got '{given}'{hint}")
        try:
            own = {**own, name: yaml.safe_load(value)}
        except yaml.YAMLError:
            raise BadInput(f"--option {name}: expected YAML, got '{value}'") from None
    return kind, own


def _checkpoint(reference: str) -> tuple[str, Mapping[str, Any]]:
    folder = zoo.shipped(reference)
    if (folder / CARD).is_file():
        merged = card_json(folder).get("kind") == MERGED
        return (MERGED_NAME if merged else "mergevla"), {"checkpoint": reference}
    if any(folder.glob(f"*/{CARD}")):
        return EXPERTS_NAME, {"folder": reference}
    raise BadInput(
        f"expected a checkpoint's folder, zoo:NAME or a kind of policy, got '{reference}'"
        f"{nearest(reference, catalog.kinds())}"
    )
