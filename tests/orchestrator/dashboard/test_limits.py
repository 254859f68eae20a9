"""Limits of the dashboard: clients that send or read too slowly, slow pages, the room of uploads."""

import asyncio
import socket
import time
from urllib.parse import urlsplit

import pytest
from fastapi import HTTPException

from robogauntlet.orchestrator.dashboard import upload
from robogauntlet.orchestrator.dashboard.answers import AnswerCache, SlowWork
from robogauntlet.orchestrator.dashboard.server import DeadlineProtocol
from robogauntlet.orchestrator.dashboard.upload_places import UploadPlaces
from tests.orchestrator.dashboard.conftest import serving
from tests.orchestrator.dashboard.test_uploading import begin_upload, exported, left_over  # noqa: F401

MB = 1_000_000


class Quick(DeadlineProtocol):
    HEADER_S = 0.5
    READ_S = 0.5


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("quick"), protocol=Quick, body_grace_s=0.5) as served:
        yield served


def connected(served):
    place = urlsplit(served.address)
    return socket.create_connection((place.hostname, place.port), timeout=30)


def rest(connection):
    """What the server still sends until it ends the connection."""
    found = b""
    try:
        while part := connection.recv(65536):
            found += part
    except ConnectionResetError:
        pass
    return found


@pytest.mark.parametrize(
    "sent", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: localhost\r\n"], ids=["none", "line", "half"]
)
def test_a_connection_without_a_whole_header_is_ended(quick, sent):
    with connected(quick) as connection:
        connection.sendall(sent)
        assert rest(connection) == b""


def test_the_second_header_of_a_connection_has_a_deadline_too(quick):
    with connected(quick) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\nGET /hea")
        answer = rest(connection)
    assert answer.count(b"HTTP/1.1 200") == 1


def test_a_header_in_small_pieces_has_one_deadline(quick):
    with connected(quick) as connection:
        begun = time.monotonic()
        try:
            for letter in b"GET /healthz HTTP/1.1\r\nX-Long: " + b"x" * 600:
                connection.sendall(bytes([letter]))
                time.sleep(0.05)
        except OSError:
            pass
        assert time.monotonic() - begun < 20


def test_a_client_that_does_not_read_its_answer_is_ended(quick):
    with connected(quick) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for _ in range(400):  # more answers than the kernel keeps
            try:
                connection.sendall(b"GET /static/report.css HTTP/1.1\r\nHost: localhost\r\n\r\n")
            except OSError:
                break
        deadline = time.monotonic() + 30
        ended = False
        while not ended and time.monotonic() < deadline:
            try:
                connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
            except OSError:
                ended = True
            time.sleep(0.1)
    assert ended


@pytest.mark.parametrize("path", ["/runs", "/login"])
def test_a_body_that_stalls_is_answered_and_leaves_nothing(quick, path):
    with connected(quick) as connection:
        head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5000\r\n\r\ntoken=x"
        connection.sendall(head.encode())
        answer = rest(connection).decode()
    assert answer.startswith("HTTP/1.1 408")
    assert "expected 16 kB a second or more" in answer
    assert left_over(quick.root) == []


def test_a_stalled_upload_frees_its_place(quick, exported):  # noqa: F811
    stalled = [begin_upload(quick, b"SQLite", length=500_000) for _ in range(10)]
    assert quick.post("/runs", content=exported[1]).status_code == 201
    for connection in stalled:
        connection.close()


def test_uploads_beyond_the_room_are_refused_until_runs_are_removed(tmp_path, exported, monkeypatch):  # noqa: F811
    monkeypatch.setattr("robogauntlet.orchestrator.dashboard.upload_places.REMEASURE_S", 0.0)
    run, body = exported
    with serving(tmp_path / "runs", max_uploads=len(body) + 10) as served:
        assert served.post("/runs", content=body).status_code == 201
        answer = served.post("/runs", content=body)
        assert answer.status_code == 507
        assert "--max-uploads-gb" in answer.text
        assert len(answer.text.splitlines()) == 1
        assert left_over(served.root) == []
        served.history.remove(run.run_id)
        assert served.post("/runs", content=body).status_code == 400  # there is room; the folder is still there


def test_the_room_is_not_measured_for_each_upload():
    measured = []

    async def uploads():
        places = UploadPlaces(10 * MB, lambda: measured.append(1) or 0)
        for _ in range(5):
            async with places.place(MB) as place:
                place.size = MB // 2
        async with places.place(7 * MB):
            with pytest.raises(HTTPException) as refused:
                async with places.place(MB):
                    pass
        return refused.value.status_code

    assert asyncio.run(uploads()) == 507
    assert measured == [1]


def test_an_upload_that_fails_leaves_its_room_to_others():
    async def uploads():
        places = UploadPlaces(MB, lambda: 0)
        for _ in range(3):
            with pytest.raises(ZeroDivisionError):
                async with places.place(MB):
                    raise ZeroDivisionError
        async with places.place(MB):
            return True

    assert asyncio.run(uploads())


def test_an_upload_waits_for_a_place_only_so_long():
    async def uploads():
        places = UploadPlaces(MB, lambda: 0, at_once=1, wait_s=0.05)
        async with places.place(1):
            with pytest.raises(HTTPException) as refused:
                async with places.place(1):
                    pass
        return refused.value

    refused = asyncio.run(uploads())
    assert (refused.status_code, "retry-after" in refused.headers) == (503, True)


def test_an_unexpected_error_in_an_upload_is_its_senders_mistake(tmp_path, exported, monkeypatch):  # noqa: F811
    def broken(*_, **__):
        raise TypeError("can only concatenate str")

    monkeypatch.setattr(upload, "import_run", broken)
    with serving(tmp_path / "runs") as served:
        answer = served.post("/runs", content=exported[1])
        assert (answer.status_code, len(answer.text.splitlines())) == (400, 1)
        assert "expected an exported run" in answer.text
        assert left_over(served.root) == []


def test_simultaneous_requests_of_a_slow_answer_share_its_computation():
    made = []

    async def requests():
        work, cache = SlowWork(1, 0), AnswerCache(4)
        compute = lambda: made.append(1) or time.sleep(0.05) or "answer"  # noqa: E731
        answers = await asyncio.gather(*(work.answer(cache, "key", compute) for _ in range(20)))
        return [*answers, await work.answer(cache, "key", compute)]

    assert asyncio.run(requests()) == ["answer"] * 21
    assert made == [1]
