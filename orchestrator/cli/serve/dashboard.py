"""`robogauntlet serve dashboard`: serve the dashboard."""

from __future__ import annotations

import logging
import os
import re
import socket
import sys
import threading
import time
from contextlib import closing, suppress
from typing import Annotated
from urllib.parse import urlsplit

import typer

from robogauntlet.orchestrator.cli.common import TOKEN, HistoryUrl, Host, Port, open_history, print_line, runs_root
from robogauntlet.support.errors import BadInput
from robogauntlet.support.network import is_loopback

log = logging.getLogger("robogauntlet.dashboard")
LEAST_TOKEN = 16
"""Fewest characters of a token that other machines may try."""
SWITCH_S = 0.0005
"""How long a thread that computes keeps others waiting (s): a page waits for its turn dozens of times."""
LAST_S = 1.0
"""Time that threads have to end after the server (s)."""
PUBLIC_URL = re.compile(r"https?://([\w.-]+|\[[0-9a-f:.]+\])(:\d{1,5})?", re.IGNORECASE)
PublicUrl = Annotated[
    str | None,
    typer.Option(
        "--public-url",
        metavar="URL",
        envvar="ROBOGAUNTLET_PUBLIC_URL",
        help="Address of the dashboard in browsers, if a proxy is in front of it.",
    ),
]


def serve(host: Host = "127.0.0.1", port: Port = 8770, public_url: PublicUrl = None, url: HistoryUrl = None) -> None:
    """Serve the dashboard.

    Its pages show running suites, results and schedules, and change nothing. Ctrl-C stops it.
    """
    public = public_address(public_url)
    public_host = None if public is None else urlsplit(public).hostname
    token = _token(host, public, public_host)

    from robogauntlet.orchestrator.dashboard.app import create_app, server_of
    from robogauntlet.orchestrator.dashboard.app_state import Settings
    from robogauntlet.orchestrator.schedules.store import ScheduleStore

    listening = listen(host, port)
    with listening, open_history(url) as history, closing(ScheduleStore.open(history.url)) as schedule_store:
        is_https = public is not None and public.startswith("https:")
        settings = Settings(runs_root(url), host, token, public_host=public_host, is_https=is_https)
        server = server_of(create_app(history, schedule_store, settings))
        shown = f"[{host}]" if ":" in host else host
        address = f"http://{shown}:{listening.getsockname()[1]}/"
        names = address if public is None else f"{public}/, behind it {address}"
        print_line(f"dashboard: {names}  (stop with Ctrl-C)")
        _log_to_stderr()
        log.info("started at %s, %s", address, "a token is needed" if token else "no token is needed")
        os.nice(19)  # below Ray's workers, which have 15
        sys.setswitchinterval(SWITCH_S)
        with suppress(KeyboardInterrupt):  # Ctrl-C or SIGTERM
            server.run(sockets=[listening])
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
    """Write the dashboard's log to standard error: a line with its time for each wrong token and each problem."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    log.propagate = False


def public_address(url: str | None) -> str | None:
    """The public address in small letters, without a slash at its end; None if there is none. Raises BadInput."""
    if url is None:
        return None
    address = url.removesuffix("/").lower()
    if not PUBLIC_URL.fullmatch(address):
        raise BadInput(f"--public-url: expected an address such as https://lab.example.org without a path, got '{url}'")
    return address


def _token(host: str, public: str | None, public_host: str | None) -> str | None:
    """The token that requests must carry. Raises BadInput if it is missing where others can connect, or malformed."""
    token = os.environ.get(TOKEN) or None
    is_public = not is_loopback(host) or (public_host is not None and not is_loopback(public_host))
    option = f"--host {host}" if not is_loopback(host) else f"--public-url {public}"
    advice = f"for example: export {TOKEN}=$(openssl rand -hex 32)"
    if token is None and is_public:
        raise BadInput(
            f"{option}: other machines can reach it; expected a token in the variable {TOKEN}, got none; {advice}"
        )
    if token is not None and not (token.isascii() and token.isprintable() and " " not in token):
        raise BadInput(f"{TOKEN}: expected ASCII characters without spaces")
    if token is not None and is_public and len(token) < LEAST_TOKEN:
        raise BadInput(f"{TOKEN}: expected at least {LEAST_TOKEN} characters with {option}, got {len(token)}; {advice}")
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
        listening = socket.create_server((host, port), family=family, backlog=256, dualstack_ipv6=both)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        raise BadInput(f"{host}:{port}: cannot listen: {reason}; choose another port with --port") from None
    # For the connections, too: else the kernel keeps the body of an answer back until the client confirms its header.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening
