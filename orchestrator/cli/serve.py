"""`robogauntlet serve`: serve the dashboard."""

from __future__ import annotations

import os
import socket
from contextlib import closing, suppress
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import TOKEN, HistoryUrl, Host, Port, open_history, out, runs_root
from robogauntlet.support.errors import BadInput
from robogauntlet.support.network import is_loopback


def serve(
    host: Host = "127.0.0.1",
    port: Port = 8770,
    max_upload_mb: Annotated[int, typer.Option(min=1, help="Largest size of an uploaded run (MB).")] = 256,
    url: HistoryUrl = None,
) -> None:
    """Serve the dashboard.

    Its pages show running suites, results and schedules. Ctrl-C stops it.
    """
    import uvicorn

    from robogauntlet.orchestrator.dashboard.app import create_app
    from robogauntlet.orchestrator.dashboard.app_state import Settings
    from robogauntlet.orchestrator.schedules.store import ScheduleStore

    token = _token(host)
    listening = listen(host, port)
    os.nice(19)  # below Ray's workers, which have 15
    with listening, open_history(url) as history, closing(ScheduleStore.open(history.url)) as schedule_store:
        app = create_app(history, schedule_store, Settings(runs_root(url), host, token, max_upload_mb * 1024 * 1024))
        config = uvicorn.Config(
            app, log_level="warning", access_log=False, server_header=False, ws="none", timeout_graceful_shutdown=3
        )
        shown = f"[{host}]" if ":" in host else host
        out.print(f"dashboard: http://{shown}:{listening.getsockname()[1]}/  (stop with Ctrl-C)", soft_wrap=True)
        with suppress(KeyboardInterrupt):  # Ctrl-C or SIGTERM
            uvicorn.Server(config).run(sockets=[listening])


def _token(host: str) -> str | None:
    """The token that requests must carry, or None. Raises BadInput if the host needs one or it is malformed."""
    token = os.environ.get(TOKEN) or None
    if token is None and not is_loopback(host):
        raise BadInput(
            f"--host {host}: other machines can reach it; expected a token in the variable {TOKEN}, got none; "
            f"for example: export {TOKEN}=$(openssl rand -hex 32)"
        )
    if token is not None and not (token.isascii() and token.isprintable() and " " not in token):
        raise BadInput(f"{TOKEN}: expected ASCII characters without spaces")
    return token


def listen(host: str, port: int) -> socket.socket:
    """Open a socket that listens on a host (name or address) and a port (0: any free port).

    Raises:
        BadInput: The port is taken, or the address is not one of this machine.
    """
    host = host.strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    both = family is socket.AF_INET6 and socket.has_dualstack_ipv6()
    try:
        return socket.create_server((host, port), family=family, backlog=256, dualstack_ipv6=both)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        raise BadInput(f"{host}:{port}: cannot listen: {reason}; choose another port with --port") from None
