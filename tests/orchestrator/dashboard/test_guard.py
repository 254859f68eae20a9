"""Access to the dashboard, and the files that it serves."""

import http.client
import logging
import re
import signal
import socket
import subprocess
from urllib.parse import urlsplit

import httpx2
import pytest

from robogauntlet.orchestrator.cli.serve.dashboard import public_address
from robogauntlet.orchestrator.dashboard.files import known_file
from robogauntlet.orchestrator.dashboard.security import COOKIE, cookie_of
from robogauntlet.results.report import write_report
from robogauntlet.support.errors import BadInput
from tests.orchestrator.dashboard.conftest import PLAIN, serving
from tests.orchestrator.dashboard.filled import nightly_run
from tests.processes import GAUNTLET

TOKEN = "correct-horse-battery-staple"
SERVE = [*GAUNTLET, "serve", "dashboard"]


@pytest.fixture(scope="module")
def locked(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("locked"), token=TOKEN, host="0.0.0.0") as served:
        yield served


@pytest.fixture(scope="module")
def public(tmp_path_factory):
    root = tmp_path_factory.mktemp("public")
    with serving(root, token=TOKEN, public_host="lab.example.org", is_https=True) as served:
        yield served


def raw(served, path, **headers):
    """The answer to a path as it is: nothing between normalises it."""
    connection = http.client.HTTPConnection(urlsplit(served.address).netloc, timeout=30)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body.decode()


def test_every_page_asks_for_the_token(locked):
    for path in ("/", "/runs", "/api/live", "/metrics", "/healthz", "/runs/x/files/report.html", "/nowhere"):
        answer = locked.get(path)
        assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
        assert len(answer.text.splitlines()) == 1
    assert locked.post("/runs", content=b"x").status_code == 401


def test_a_browser_is_redirected_to_the_login(locked):
    answer = locked.get("/runs?suite=a", headers={"accept": "text/html"}, follow_redirects=False)
    assert answer.headers["location"] == "/login?next=%2Fruns%3Fsuite%3Da"
    assert 'value="/runs?suite=a"' in locked.get(answer.headers["location"]).text
    assert locked.get("/static/dashboard.css").status_code == 200


def test_the_token_opens_every_page(locked):
    assert locked.get("/", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200


@pytest.mark.parametrize("shown", [f"Bearer {TOKEN}x", "Bearer", "", f"Basic {TOKEN}", TOKEN, "Bearer \xe9\xff"])
def test_a_wrong_token_opens_no_page(locked, shown):
    assert locked.get("/", headers={"authorization": shown.encode("latin-1")}).status_code == 401


def test_the_login_sets_a_cookie_without_the_token(locked):
    answer = locked.post("/login", data={"token": TOKEN, "next": "/runs"}, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/runs")
    cookie, *attributes = answer.headers["set-cookie"].lower().split("; ")
    assert TOKEN not in cookie
    assert {"httponly", "samesite=strict"} <= set(attributes)
    assert "secure" not in attributes
    assert locked.get("/", headers={"cookie": cookie}).status_code == 200
    assert locked.get("/", headers={"cookie": cookie[:-1]}).status_code == 401


def test_the_cookie_of_another_token_opens_no_page(locked):
    for shown in (TOKEN, cookie_of(f"{TOKEN}x"), ""):
        assert locked.get("/", headers={"cookie": f"{COOKIE}={shown}"}).status_code == 401


def test_the_login_refuses_a_wrong_token_and_leads_to_no_other_site(locked):
    assert locked.post("/login", data={"token": "guess"}).status_code == 401
    for elsewhere in ("//evil.example", "https://evil.example", "/\\evil.example", "javascript:alert(1)"):
        answer = locked.post("/login", data={"token": TOKEN, "next": elsewhere}, follow_redirects=False)
        assert answer.headers["location"] == "/"
    assert locked.post("/login", content=b"token=" + b"x" * 10_000).status_code == 413


def test_wrong_tokens_are_logged_without_the_token(locked, caplog):
    with caplog.at_level(logging.INFO, "robogauntlet.dashboard"):
        locked.post("/login", data={"token": "my-guess"})
        locked.get("/runs", headers={"authorization": "Bearer my-guess"})
    assert [record.getMessage() for record in caplog.records] == [
        f"wrong token from 127.0.0.1 for {path}" for path in ("/login", "/runs")
    ]


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE"])
def test_no_request_changes_anything(filled, method):
    run_id = filled.made[0][1].run_id
    for path in ("/", "/runs", f"/runs/{run_id}", "/compare", "/schedule", "/logout", "/api/live"):
        answer = httpx2.request(method, filled.address + path, content=b"x", **PLAIN)
        assert answer.status_code in (404, 405), path


@pytest.mark.parametrize(
    "host",
    [
        *("evil.example", "evil.example:8770", "127.0.0.1.evil.example", "", "[::1", "localhost."),
        *("me@localhost", "localhost/x", "localhost:99999"),
    ],
)
def test_another_host_name_is_refused_on_loopback(filled, host):
    status, body = raw(filled, "/", Host=host)
    assert status == 400
    assert len(body.splitlines()) == 1


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:99", "127.0.0.1:8770", "[::1]:8770"])
def test_this_machines_names_are_served_on_loopback(filled, host):
    assert raw(filled, "/", Host=host)[0] == 200


@pytest.mark.parametrize(
    ("host", "status"), [("lab.example.org", 200), ("lab.example.org:443", 200), ("other.example.org", 400)]
)
def test_the_public_name_is_served_on_loopback(public, host, status):
    assert raw(public, "/login", Host=host)[0] == status


def test_the_cookie_is_for_tls_only_behind_a_public_https_address(public):
    answer = public.post("/login", data={"token": TOKEN}, follow_redirects=False)
    assert "secure" in answer.headers["set-cookie"].lower().split("; ")


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("https://Lab.example.org:8443/", "https://lab.example.org:8443"),
        ("http://[::1]:8770", "http://[::1]:8770"),
        *((wrong, None) for wrong in ("lab.example.org", "ftp://a", "https://", "https://a@b", "https://a:b", "null")),
        *((wrong, None) for wrong in ("https://a/b", "https://a?b", "https://a b", "https://a\\b", "https://a#b", "")),
    ],
)
def test_a_public_address_is_a_scheme_a_host_and_a_port(url, address):
    if address is None:
        with pytest.raises(BadInput, match="expected an address such as"):
            public_address(url)
    else:
        assert public_address(url) == address


def test_answers_have_the_security_headers(filled):
    for path in ("/", "/nowhere", "/api/live", "/static/live.js"):
        headers = filled.get(path).headers
        assert "script-src 'self';" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "same-origin"
        assert headers["x-frame-options"] == "DENY"


def test_no_page_has_an_inline_script_or_style(filled):
    run = filled.made[-1][1].run_id
    for path in ("/", "/runs", f"/runs/{run}", "/history?policy=merged", "/leaderboard?suite=nightly", "/failures"):
        page = filled.get(path).text
        assert not re.search(r"<script(?! src=)|\son[a-z]+=|\sstyle=|javascript:", page)


@pytest.mark.parametrize(
    "path",
    [
        *("run.json", "episodes.sqlite", "../history.sqlite", "media/../run.json", "media/../../history.sqlite"),
        *("..%2fhistory.sqlite", "%2e%2e/history.sqlite", "%2e%2e%2fhistory.sqlite", "media/..%2f..%2fhistory.sqlite"),
        *("..%5chistory.sqlite", "%252e%252e/history.sqlite"),
        *("/etc/passwd", "%2fetc%2fpasswd", "media/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd"),
        *("report.html%00.png", "media/videos/%00.mp4", "media/videos", "media", "", "media/..png"),
        *("report.html/", "REPORT.HTML"),
    ],
)
def test_no_other_file_of_a_run_is_served(filled, path):
    status, body = raw(filled, f"/runs/{filled.made[-1][1].run_id}/files/{path}")
    assert status in (400, 404)
    assert "SQLite" not in body
    assert "root:" not in body


def test_links_that_lead_out_of_the_run_are_not_followed(tmp_path):
    folder, secret = tmp_path / "run", tmp_path / "secret.png"
    (folder / "media").mkdir(parents=True)
    secret.write_text("secret")
    (folder / "episodes.sqlite").write_text("rows")
    (folder / "media" / "out.png").symlink_to(secret)
    (folder / "media" / "rows.png").symlink_to(folder / "episodes.sqlite")
    (folder / "report.html").symlink_to("/etc/passwd")
    (folder / "media" / "in.png").write_text("picture")
    (folder / "media" / "linked").symlink_to(tmp_path)
    assert known_file(folder, "media/in.png") == folder / "media" / "in.png"
    for path in ("media/out.png", "media/rows.png", "report.html", "media/linked/secret.png"):
        assert known_file(folder, path) is None


def test_every_file_of_a_report_is_shown(tmp_path):
    folder, _, _ = nightly_run(tmp_path, 0, 0.0, seeds=2)
    write_report(folder)
    for name in ("report.html", "report.md", "summary.json", "cells.csv"):
        assert known_file(folder, name) == folder / name


@pytest.mark.parametrize(
    ("arguments", "token", "words"),
    [
        (("--host", "0.0.0.0"), None, "expected a token in the variable ROBOGAUNTLET_TOKEN, got none"),
        (("--host", "0.0.0.0"), "abc", "expected at least 16 characters with --host 0.0.0.0, got 3"),
        (("--public-url", "https://lab.example.org"), None, "--public-url https://lab.example.org: other machines can"),
        ((), "a b", "ROBOGAUNTLET_TOKEN: expected ASCII characters without spaces"),
    ],
)
def test_a_token_that_does_not_protect_is_refused(run_command, monkeypatch, tmp_path, arguments, token, words):
    monkeypatch.delenv("ROBOGAUNTLET_TOKEN", raising=False)
    if token is not None:
        monkeypatch.setenv("ROBOGAUNTLET_TOKEN", token)
    history = f"sqlite:///{tmp_path}/runs/history.sqlite"
    assert words in run_command("serve", "dashboard", "--port", "0", "--history", history, *arguments).refusal
    assert not (tmp_path / "runs").exists()


def test_a_port_in_use_is_one_line(run_command, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = run_command("serve", "dashboard", "--port", port, "--history", f"sqlite:///{tmp_path}/history.sqlite")
    assert f"127.0.0.1:{port}: cannot listen: Address already in use" in done.refusal


def test_the_command_serves_until_it_is_interrupted(tmp_path):
    command = [*SERVE, "--port", "0", "--history", f"sqlite:///{tmp_path}/history.sqlite"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        address = re.search(r"http://[0-9.:]+/", process.stdout.readline())[0]
        assert httpx2.get(address, trust_env=False, timeout=30).status_code == 200
        process.send_signal(signal.SIGINT)
        _, complaints = process.communicate(timeout=60)
    assert process.returncode == 0
    assert re.fullmatch(rf"\S+ \S+ INFO started at {address}, no token is needed\n", complaints)


def test_a_file_that_is_no_store_is_one_line(run_command, tmp_path):
    (tmp_path / "history.sqlite").write_text("this text is no store, whatever the name of its file\n" * 99)
    done = run_command("serve", "dashboard", "--port", "0", "--history", f"sqlite:///{tmp_path}/history.sqlite")
    assert "expected a store" in done.refusal
