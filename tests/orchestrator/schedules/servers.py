"""Real servers on this machine that receive notifications: a webhook that first fails, and an SMTP server."""

import contextlib
import json
import os
import socket
import socketserver
import ssl
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult

os.environ["NO_PROXY"] = "*"  # notifications of tests stay on this machine


class Hook(ThreadingHTTPServer):
    """Answers with the statuses of `script` in turn, then with 200; stores the JSON of each request."""

    def __init__(self, script=(), headers=(), echo=False, tls=None):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.script, self.headers, self.echo = list(script), dict(headers), echo
        self.received, self.paths = [], []
        self.scheme = "http"
        if tls is not None:
            self.socket = tls.wrap_socket(self.socket, server_side=True)
            self.scheme = "https"

    @property
    def url(self):
        return f"{self.scheme}://localhost:{self.server_address[1]}/services/T0/B0/s3cr3t"

    def handle_error(self, request, client_address):
        pass  # a client that does not trust the certificate leaves

    def __enter__(self):
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.shutdown()
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.received.append(json.loads(body))
        self.server.paths.append(self.path)
        status = self.server.script.pop(0) if self.server.script else 200
        if status == "hang up":
            return
        if status == "no http":
            self.wfile.write(b"220 " + self.path.encode() + b" ESMTP\r\n")
            return
        body = (self.path if self.server.echo else status if isinstance(status, str) else "ok").encode()
        self.send_response(400 if isinstance(status, str) else status, body.decode() if self.server.echo else None)
        headers = self.server.headers | ({"Location": self.path, "X-Path": self.path} if self.server.echo else {})
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


class Inbox:
    """Stores mails; refuses as often as `script` says, and the recipients in `unknown`."""

    def __init__(self, script=(), unknown=()):
        self.script, self.unknown, self.mails, self.encrypted, self.tries = list(script), unknown, [], [], 0

    async def handle_MAIL(self, server, session, envelope, address, options):  # noqa: N802
        self.tries += 1
        if self.script:
            return self.script.pop(0)
        envelope.mail_from = address
        return "250 OK"

    async def handle_RCPT(self, server, session, envelope, address, options):  # noqa: N802
        if address in self.unknown:
            return f"550 5.1.1 no {address} here"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, server, session, envelope):  # noqa: N802
        self.mails.append(envelope)
        self.encrypted.append(session.ssl is not None)
        return "250 OK"


class Users:
    """Accepts the right password. Repeats a wrong one, as no server should."""

    def __init__(self, user, password):
        self.user, self.password = user, password

    def __call__(self, server, session, envelope, mechanism, data):
        if data.login == self.user.encode() and data.password == self.password.encode():
            return AuthResult(success=True)
        refusal = f"535 5.7.8 not {data.login.decode()} with {data.password.decode()}"
        return AuthResult(success=False, handled=False, message=refusal)


@contextlib.contextmanager
def smtp(inbox, **options):
    """A server that gives `inbox` what comes; yields its port."""
    with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    controller = Controller(inbox, hostname="127.0.0.1", port=port, **options)
    controller.start()
    try:
        yield port
    finally:
        controller.stop()


@contextlib.contextmanager
def greeter(words):
    """A server that sends one text and hangs up; yields its port."""

    class Greeting(socketserver.StreamRequestHandler):
        def handle(self):
            self.wfile.write(words)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Greeting) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


def closed_port():
    """A port without a listener."""
    with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as free:
        return free.getsockname()[1]


def certified(authority, name="localhost"):
    """The TLS of a server with a certificate of this authority (trustme.CA)."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert(name).configure_cert(context)
    return context
