"""`robogauntlet serve`: serve the dashboard."""

from __future__ import annotations

import logging
import os
import socket
import sys
import threading
import time
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Annotated

import typer

from robogauntlet.orchestrator.cli.common import TOKEN, HistoryUrl, Host, Port, open_history, print_line, runs_root
from robogauntlet.support.errors import BadInput
from robogauntlet.support.network import is_loopback

if TYPE_CHECKING:
    from robogauntlet.orchestrator.dashboard.origins import Origin

log = logging.getLogger("robogauntlet.dashboard")
TOKEN_READ = "ROBOGAUNTLET_TOKEN_READ"
LEAST_TOKEN = 16
"""Fewest characters of a token that other machines may try."""
LAST_S = 1.0
"""Time that threads have to end after the server (s)."""
PublicUrl = Annotated[
    str | None,
    typer.Option(
        "--public-url",
        metavar="URL",
        envvar="ROBOGAUNTLET_PUBLIC_URL",
        help="Address of the dashboard in browsers, if a proxy is in front of it.",
    ),
]


def serve(
    host: Host = "127.0.0.1",
    port: Port = 8770,
    public_url: PublicUrl = None,
    max_upload_mb: Annotated[int, typer.Option(min=1, help="Largest size of an uploaded run (MB).")] = 256,
    max_uploads_gb: Annotated[
        float, typer.Option(min=0.001, max=1e6, help="Largest size of all uploaded runs together (GB).")
    ] = 20.0,
    url: HistoryUrl = None,
) -> None:
    """Serve the dashboard.

    Its pages show running suites, results and schedules. Ctrl-C stops it.
    """
    public = None if public_url is None else public_origin(public_url)
    token, read_token = _tokens(host, public)

    import uvicorn

    from robogauntlet.orchestrator.dashboard.app import create_app
    from robogauntlet.orchestrator.dashboard.app_state import Settings
    from robogauntlet.orchestrator.dashboard.server import SWITCH_S, server_config
    from robogauntlet.orchestrator.schedules.store import ScheduleStore

    listening = listen(host, port)
    with listening, open_history(url) as history, closing(ScheduleStore.open(history.url)) as schedule_store:
        settings = Settings(
            runs_root(url),
            host,
            token,
            read_token=read_token,
            public=public,
            max_upload=max_upload_mb * 1024 * 1024,
            max_uploads=int(max_uploads_gb * 1e9),
        )
        app = create_app(history, schedule_store, settings)
        shown = f"[{host}]" if ":" in host else host
        address = f"http://{shown}:{listening.getsockname()[1]}/"
        names = address if public is None else f"{public}/, behind it {address}"
        print_line(f"dashboard: {names}  (stop with Ctrl-C)")
        _log_to_stderr()
        log.info("started at %s, %s", address, "a token is needed" if token else "no token is needed")
        os.nice(19)  # below Ray's workers, which have 15
        sys.setswitchinterval(SWITCH_S)
        with suppress(KeyboardInterrupt):  # Ctrl-C or SIGTERM
            uvicorn.Server(server_config(app)).run(sockets=[listening])
    _end_slow_answers()


def _end_slow_answers() -> None:
    """End the process if threads still compute answers: nobody waits for them, but the interpreter would."""
    until = time.monotonic() + LAST_S
    for thread in threading.enumerate():
        if thread not in (threading.current_thread(), threading.main_thread()) and not thread.daemon:
            thread.join(max(0.0, until - time.monotonic()))
            if thread.is_alive():
                log.warning("stopped before all slow answers were computed")
                sys.stdout.flush()
                os._exit(0)


def _log_to_stderr() -> None:
    """Write the dashboard's log to standard error: a line with its time for each upload and each wrong token."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    log.propagate = False


def public_origin(url: str) -> Origin:
    """The origin of the public address. Raises BadInput."""
    from robogauntlet.orchestrator.dashboard.origins import origin_of

    origin = origin_of(url.removesuffix("/"))
    if origin is None:
        raise BadInput(f"--public-url: expected an address such as https://lab.example.org without a path, got '{url}'")
    return origin


def _tokens(host: str, public: Origin | None) -> tuple[str | None, str | None]:
    """The tokens for everything and for reading. Raises BadInput if one is missing, malformed or too short."""
    token, read_token = (os.environ.get(name) or None for name in (TOKEN, TOKEN_READ))
    is_public = not is_loopback(host) or (public is not None and not is_loopback(public.host))
    option = f"--host {host}" if not is_loopback(host) else f"--public-url {public}"
    advice = f"for example: export {TOKEN}=$(openssl rand -hex 32)"
    if token is None and is_public:
        raise BadInput(
            f"{option}: other machines can reach it; expected a token in the variable {TOKEN}, got none; {advice}"
        )
    for name, value in ((TOKEN, token), (TOKEN_READ, read_token)):
        if value is not None and not (value.isascii() and value.isprintable() and " " not in value):
            raise BadInput(f"{name}: expected ASCII characters without spaces")
        if value is not None and is_public and len(value) < LEAST_TOKEN:
            raise BadInput(
                f"{name}: expected at least {LEAST_TOKEN} characters with {option}, got {len(value)}; {advice}"
            )
    if read_token is not None and read_token == token:
        raise BadInput(f"{TOKEN_READ}: expected another token than {TOKEN}")
    if read_token is not None and token is None:
        raise BadInput(f"{TOKEN_READ}: expected {TOKEN} beside it, the token that may upload; {advice}")
    return token, read_token


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
