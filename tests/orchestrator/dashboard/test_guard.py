"""Access to the dashboard, and the files that it serves."""

import http.client
import re
import signal
import socket
import subprocess
from urllib.parse import urlsplit

import httpx2
import pytest

from robogauntlet.orchestrator.dashboard.files import known_file
from robogauntlet.results.report import write_report
from tests.orchestrator.dashboard.conftest import serving
from tests.orchestrator.dashboard.filled import nightly_run
from tests.processes import GAUNTLET

TOKEN = "correct-horse-battery-staple"
SERVE = [*GAUNTLET, "serve"]


@pytest.fixture(scope="module")
def locked(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("locked"), token=TOKEN, host="0.0.0.0") as served:
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


def test_the_login_starts_a_session_without_the_token_in_its_cookie(locked):
    answer = locked.post("/login", data={"token": TOKEN, "next": "/runs"}, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/runs")
    cookie = answer.headers["set-cookie"]
    assert TOKEN not in cookie
    assert "httponly" in cookie.lower()
    assert "samesite=strict" in cookie.lower()
    value = re.match(r"robogauntlet_session=([^;]+)", cookie)[1]
    assert locked.get("/", headers={"cookie": f"robogauntlet_session={value}"}).status_code == 200
    assert locked.get("/", headers={"cookie": f"robogauntlet_session={value[:-1]}"}).status_code == 401
    locked.post("/logout", headers={"cookie": f"robogauntlet_session={value}"})
    assert locked.get("/", headers={"cookie": f"robogauntlet_session={value}"}).status_code == 401


def test_the_login_refuses_a_wrong_token_and_other_sites(locked):
    assert locked.post("/login", data={"token": "guess"}).status_code == 401
    for elsewhere in ("//evil.example", "https://evil.example", "/\\evil.example", "javascript:alert(1)"):
        answer = locked.post("/login", data={"token": TOKEN, "next": elsewhere}, follow_redirects=False)
        assert answer.headers["location"] == "/"
    assert locked.post("/login", content=b"token=" + b"x" * 10_000).status_code == 413


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8770", "127.0.0.1.evil.example", "", "[::1", "localhost."]
)
def test_another_host_name_is_refused_on_loopback(filled, host):
    status, body = raw(filled, "/", Host=host)
    assert status == 400
    assert len(body.splitlines()) == 1


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:99", "127.0.0.1:8770", "[::1]:8770"])
def test_this_machines_names_are_served_on_loopback(filled, host):
    assert raw(filled, "/", Host=host)[0] == 200


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("origin", "https://evil.example"), ("origin", "null")),
        *(("sec-fetch-site", "cross-site"), ("sec-fetch-site", "same-site")),
    ],
)
def test_changes_from_pages_of_other_sites_are_refused(filled, name, value):
    for path in ("/runs", "/login", "/logout"):
        assert filled.post(path, content=b"x", headers={name: value}).status_code == 403


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


def test_an_address_that_other_machines_reach_needs_a_token(run_command, monkeypatch):
    monkeypatch.delenv("ROBOGAUNTLET_TOKEN", raising=False)
    assert "ROBOGAUNTLET_TOKEN" in run_command("serve", "--host", "0.0.0.0").refusal


def test_a_port_in_use_is_one_line(run_command, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = run_command("serve", "--port", port, "--history", f"sqlite:///{tmp_path}/history.sqlite")
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
    done = run_command("serve", "--port", "0", "--history", f"sqlite:///{tmp_path}/history.sqlite")
    assert "expected a store" in done.refusal
