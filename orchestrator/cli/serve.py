"""`gauntlet serve`: the dashboard."""

from __future__ import annotations

import os
import socket
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, HistoryUrl, history_url, open_history, out, runs_root

TOKEN = "GAUNTLET_TOKEN"


def serve(
    host: Annotated[
        str, typer.Option(help=f"Address to listen at. Others than this machine's own need a token in {TOKEN}.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 for any that is free.")] = 8770,
    max_upload_mb: Annotated[int, typer.Option(min=1, help="Largest run that may be uploaded (MB).")] = 256,
    url: HistoryUrl = None,
) -> None:
    """Serve pages that show what runs, what came of it and what is due, until Ctrl-C."""
    import uvicorn

    from orchestrator.calendar.book import Book
    from orchestrator.dashboard.app import create_app
    from orchestrator.dashboard.desk import Settings
    from results.database import StoreError

    token = _token(host)
    listening = listen(host, port)
    os.nice(19)  # who watches takes no time from what runs: Ray's workers have 15
    try:
        with open_history(url) as history:
            try:
                book = Book.open(history_url(url))
            except StoreError as error:
                raise BadInput(str(error)) from None
            settings = Settings(runs_root(url), host, token, max_upload_mb * 1024 * 1024)
            config = uvicorn.Config(
                create_app(history, book, settings),
                log_level="warning",
                access_log=False,
                server_header=False,
                ws="none",
                timeout_graceful_shutdown=3,
            )
            shown = f"[{host}]" if ":" in host else host
            out.print(f"dashboard: http://{shown}:{listening.getsockname()[1]}/  (Ctrl-C ends it)", soft_wrap=True)
            try:
                uvicorn.Server(config).run(sockets=[listening])
            except KeyboardInterrupt:
                pass  # asked to end, by Ctrl-C or SIGTERM: what a server is for is over
            finally:
                book.close()
    finally:
        listening.close()


def _token(host: str) -> str | None:
    """The token that requests have to show. Raises BadInput: there has to be one and is none, or none that works."""
    from orchestrator.dashboard.guard import is_loopback

    token = os.environ.get(TOKEN) or None
    if token is None and not is_loopback(host):
        raise BadInput(
            f"--host {host}: others can reach it, expected a token in the environment variable {TOKEN}, there is none; "
            f"for example: export {TOKEN}=$(openssl rand -hex 32)"
        )
    if token is not None and not (token.isascii() and token.isprintable() and " " not in token):
        raise BadInput(f"{TOKEN}: expected ASCII characters without spaces")
    return token


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens at an address (a name or a number) and a port (0: any that is free).

    Raises:
        BadInput: The port is taken, or the address is not of this machine.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host.strip("[]"), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listening = socket.socket(family, kind, protocol)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
            listening.listen(256)
        except OSError:
            listening.close()
            raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInput(f"{host}:{port}: cannot listen there: {reason}; choose another with --port") from None
    return listening
