"""A server that means harm costs its client one line, bounded memory and bounded time."""

import resource
import socket
import threading
import time

import msgpack
import numpy as np
import pytest

from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, Routing, check_routing
from robogauntlet.policies.remote.msgpack_numpy import pack
from robogauntlet.policies.remote.protocol import VERSION
from tests.errors import one_line_error
from tests.policies.remote.test_client import CHUNK, query
from tests.remote_servers import answering, speaking

LIMITS = {"timeout_s": 3.0, "connect_timeout_s": 3.0, "retries": 0}
MEBIBYTE = 2**20


def deep(levels, inner=b"\xc0"):
    return b"\x81\xa1a" * levels + inner


def array(shape, data=b"", dtype="|u1"):
    return msgpack.packb({"actions": {b"__ndarray__": True, b"dtype": dtype, b"data": data, b"shape": shape}})


def endlessly(connection, _=None):
    """A message in pieces that never ends."""

    def pieces():
        while True:
            yield b"\xc0"
            time.sleep(0.01)

    connection.send(pieces())


def hugely(connection, _=None):
    """A message in pieces that is larger than any."""
    connection.send(b"\0" * MEBIBYTE for _ in range(1_000))


def greeting(**spec):
    spec = {"sees": "observation", "chunk_length": 8, **spec}
    return {
        "robogauntlet": {"version": VERSION, "digest": spec.pop("digest", "0" * 16), "spec": spec, "remembers": False}
    }


ANSWERS = {
    "too many keys": (msgpack.packb({str(n): 0 for n in range(100_001)}), "100000 values at most"),
    "lists announced": (b"\x81\xa1a" + b"\xdd\x00\xff\xff\xff" * 100_000, "100000 values at most"),
    "nested": (deep(500), "32 levels"),
    "a thousand million actions": (array([10**9, 7], b"\0" * 70, "<f4"), "shape"),
    "actions without numbers": (array([10**9, 0]), "actions"),
    "an image": (array([40_000, 25_000, 3], b"\0" * 30), "shape"),
    "a long error": ("x" * (10 * MEBIBYTE), "got an error: x"),
    "endless": (endlessly, "expected an answer within 3 s"),
    "too large": (hugely, "expected frames no larger than 16 MiB|closed the connection|got none"),
    "nothing": (lambda *_: None, "expected an answer within 3 s"),
}
GREETINGS = {
    "nested": (deep(500), "32 levels"),
    "nested, as policy": (b"\x81\xacrobogauntlet" + deep(500), "32 levels"),
    "two mebibytes": (pack({"a": "x" * (2 * MEBIBYTE)}), "at most 1 MiB, got 2097160 bytes"),
    "endless": (endlessly, "got nothing in time"),
    "images of 10^9 pixels": (pack(greeting(image_size=31_623)), "images of 1024 px at most"),
    "chunks of 10^18": (pack(greeting(chunk_length=10**18)), "chunks of 1000000 actions"),
    "hash with escapes": (pack(greeting(digest="\x1b[31m")), "expected the policy's hash, got '.x1b"),
    "hash of a mebibyte": (pack(greeting(digest="a" * 900_000)), "expected the policy's hash, got 'aaa"),
    "a camera": (pack(greeting(cameras=["x" * 1000])), "expected cameras among third_person, wrist"),
}


def harmless(address, match):
    before, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    with one_line_error(PolicyError, match) as caught:
        policy = catalog.load("openpi", {"address": address, **LIMITS})
        try:
            policy.act([query()])
        finally:
            policy.close()
    assert len(str(caught.value)) < 600
    assert time.monotonic() - started < 30
    assert (
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 * 1024
    )  # KiB; the server is in this process


@pytest.mark.parametrize(("answer", "match"), ANSWERS.values(), ids=ANSWERS)
def test_a_hostile_answer_is_one_line(answer, match):
    with speaking(answering(answer)) as address:
        harmless(address, match)


@pytest.mark.parametrize(("metadata", "match"), GREETINGS.values(), ids=GREETINGS)
def test_a_hostile_greeting_is_one_line(metadata, match):
    def greet(connection):
        if callable(metadata):
            metadata(connection)
        connection.send(metadata)
        connection.recv()

    with speaking(greet) as address:
        harmless(address, match)


@pytest.mark.parametrize("closes", [True, False])
def test_frames_that_are_none_are_not_taken_for_silence(closes):
    def crooked(connection, _=None):
        if closes:
            connection.socket.sendall(b"\xf0\x01x")
            time.sleep(1)
        with connection.protocol_mutex:  # it does not answer the end of the connection
            connection.socket.sendall(b"\xf0\x01x")
            time.sleep(1)

    with speaking(answering(crooked)) as address:
        policy = catalog.load("openpi", {"address": address, **LIMITS, "timeout_s": 0.5})
        with one_line_error(PolicyError, "it sent what is no frame of a websocket: reserved bits must be 0"):
            policy.act([query()])


def test_a_flood_of_unasked_messages_waits_in_the_servers_memory():
    sent = []

    def flood(connection):
        connection.send(pack({"model": "test"}))
        connection.recv()
        connection.send(pack(CHUNK))
        while True:
            connection.send(b"\0" * MEBIBYTE)
            sent.append(1)

    with speaking(flood) as address:
        policy = catalog.load("openpi", {"address": address, **LIMITS})
        np.testing.assert_array_equal(policy.act([query()])[0].actions, CHUNK["actions"])
        time.sleep(1.0)
        assert len(sent) < 40
        policy.close()


@pytest.mark.parametrize("code", [301, 302, 307, 308])
def test_a_redirect_is_not_followed(code):
    reached = []
    with speaking(reached.append) as elsewhere, socket.create_server(("127.0.0.1", 0)) as listening:

        def redirect():
            connection, _ = listening.accept()
            with connection:
                connection.recv(10_000)
                connection.sendall(f"HTTP/1.1 {code} x\r\nLocation: {elsewhere}\r\nContent-Length: 0\r\n\r\n".encode())

        thread = threading.Thread(target=redirect)
        thread.start()
        address = f"ws://127.0.0.1:{listening.getsockname()[1]}"
        with one_line_error(PolicyError, f"got HTTP {code}, a redirect, which is not followed; correct the address"):
            catalog.digest("openpi", {"address": address, **LIMITS})
        thread.join()
    assert reached == []


@pytest.mark.parametrize(
    ("scores", "match"),
    [
        ({str(n): 0.0 for n in range(1001)}, "at most 1,000 scores of the router, got 1,001"),
        ({"x" * 201: 0.0}, "names of at most 200 characters, got 201"),
    ],
)
def test_scores_of_a_router_are_bounded(scores, match):
    with one_line_error(PolicyError, match):
        check_routing(Routing(scores, next(iter(scores)), 0.0))
