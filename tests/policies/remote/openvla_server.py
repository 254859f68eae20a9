"""A server in the manner of OpenVLA's and OpenVLA-OFT's `deploy.py`, written from their contract, in a thread."""

import contextlib
import http.server
import json
import threading

import json_numpy
import numpy as np


def action(observation):
    """OpenVLA's one action: dx is the first pixel; its gripper is open at 1."""
    return np.array([observation["image"][0, 0, 0] / 255, 0, 0, 0, 0, 0, 1.0])


def chunk(observation):
    """OpenVLA-OFT's chunk, a list of actions: dx is the number of the action, dy and dz what it was shown."""
    shown = observation["wrist_image"][0, 0, 0] / 255, observation["state"].sum()
    assert observation["full_image"].dtype == np.uint8
    return [np.array([step, *shown, 0, 0, 0, 0.0]) for step in range(8)]


@contextlib.contextmanager
def serving(answer=action, token=None, seen=None, path="/act"):
    """A server that answers observations with `answer(observation)`, or with (status, text); yields its address."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.reply(405 if self.path == path else 404, "{}")

        def do_POST(self):
            if token is not None and self.headers["Authorization"] != f"Bearer {token}":
                return self.reply(401, "{}")
            posted = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            double = "encoded" in posted
            observation = json_numpy.loads(posted["encoded"] if double else json.dumps(posted))
            if seen is not None:
                seen.append(observation)
            try:
                found = answer(observation)
            except Exception:
                found = "error"
            if isinstance(found, tuple):
                return self.reply(*found)
            text = json_numpy.dumps(found)
            return self.reply(200, json.dumps(text) if double else text)

        def reply(self, status, text, **headers):
            body = text.encode() if isinstance(text, str) else text
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            if 300 <= status < 400:
                self.send_header("Location", "http://127.0.0.1:1/")
            self.end_headers()
            with contextlib.suppress(OSError):
                self.wfile.write(body)

        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        try:
            yield f"openvla+http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join(5)
