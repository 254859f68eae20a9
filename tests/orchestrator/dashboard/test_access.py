"""Tokens, wrong tokens, the token for reading, and the public address of the dashboard."""

import logging
import re

import pytest

from robogauntlet.orchestrator.dashboard.access import ATTEMPTS
from robogauntlet.orchestrator.dashboard.origins import origin_of
from tests.orchestrator.dashboard.conftest import serving
from tests.orchestrator.dashboard.test_guard import raw

TOKEN, READ = "correct-horse-battery-staple", "to-look-and-not-to-touch"
PUBLIC = "https://lab.example.org"


@pytest.fixture(scope="module")
def locked(tmp_path_factory):
    root = tmp_path_factory.mktemp("locked")
    with serving(root, token=TOKEN, read_token=READ, public=origin_of(PUBLIC)) as served:
        yield served


def bearer(token, address="203.0.113.1"):
    return {"authorization": f"Bearer {token}", "x-forwarded-for": address}


def test_an_address_is_paused_after_wrong_tokens_and_others_are_not(locked):
    answers = [locked.get("/healthz", headers=bearer("guess", "203.0.113.2")) for _ in range(ATTEMPTS + 3)]
    assert [answer.status_code for answer in answers] == [401] * ATTEMPTS + [429] * 3
    assert int(answers[-1].headers["retry-after"]) > 0
    assert len(answers[-1].text.splitlines()) == 1
    login = locked.post("/login", data={"token": "guess"}, headers={"x-forwarded-for": "203.0.113.2"})
    assert login.status_code == 429
    assert locked.get("/healthz", headers=bearer("guess", "203.0.113.3")).status_code == 401


def test_the_right_token_is_let_in_from_a_paused_address(locked):
    for _ in range(ATTEMPTS + 1):
        locked.get("/healthz", headers=bearer("guess", "203.0.113.4"))
    assert locked.get("/healthz", headers=bearer(TOKEN, "203.0.113.4")).status_code == 200
    answer = locked.post(
        "/login", data={"token": TOKEN}, headers={"x-forwarded-for": "203.0.113.4"}, follow_redirects=False
    )
    assert answer.status_code == 303


def test_wrong_tokens_are_logged_without_the_token_until_the_pause(locked, caplog):
    with caplog.at_level(logging.INFO, "robogauntlet.dashboard"):
        for _ in range(ATTEMPTS + 5):
            locked.post("/login", data={"token": "my-guess"}, headers={"x-forwarded-for": "203.0.113.5"})
    lines = [record.getMessage() for record in caplog.records if "203.0.113.5" in record.getMessage()]
    assert len(lines) == ATTEMPTS
    assert lines[-1].endswith("; paused")
    assert "my-guess" not in caplog.text


def test_the_token_for_reading_reads_and_changes_nothing(locked):
    assert locked.get("/runs", headers=bearer(READ)).status_code == 200
    answer = locked.post("/runs", content=b"x", headers=bearer(READ))
    assert (answer.status_code, len(answer.text.splitlines())) == (403, 1)
    assert locked.post("/runs", content=b"x", headers=bearer(TOKEN)).status_code == 400


def test_a_login_with_the_token_for_reading_reads_and_logs_out(locked):
    answer = locked.post("/login", data={"token": READ}, follow_redirects=False)
    cookie = {"cookie": re.match(r"[^;]+", answer.headers["set-cookie"])[0]}
    assert locked.get("/runs", headers=cookie).status_code == 200
    assert locked.post("/runs", content=b"x", headers=cookie).status_code == 403
    assert locked.post("/logout", headers=cookie, follow_redirects=False).status_code == 303
    assert locked.get("/runs", headers=cookie).status_code == 401


@pytest.mark.parametrize(
    ("host", "status"), [("lab.example.org", 200), ("lab.example.org:443", 200), ("other.example.org", 400)]
)
def test_the_public_name_is_served_on_loopback(locked, host, status):
    assert raw(locked, "/login", Host=host)[0] == status


@pytest.mark.parametrize(
    ("origin", "host", "status"),
    [
        (PUBLIC, "127.0.0.1:8770", 303),  # the proxy sends its own name
        (f"{PUBLIC}:443", "lab.example.org", 303),
        (PUBLIC, "lab.example.org:443", 303),
        (f"{PUBLIC}:8443", "127.0.0.1:8770", 403),
        ("https://lab.example.org.evil.example", "lab.example.org", 403),
        ("http://lab.example.org", "127.0.0.1:8770", 403),
    ],
)
def test_the_login_works_from_pages_of_the_public_address_only(locked, origin, host, status):
    answer = locked.post(
        "/login", data={"token": TOKEN}, headers={"origin": origin, "host": host}, follow_redirects=False
    )
    assert answer.status_code == status


def test_the_cookie_is_for_tls_only_behind_a_public_https_address(locked):
    answer = locked.post("/login", data={"token": TOKEN}, follow_redirects=False)
    assert "secure" in answer.headers["set-cookie"].lower().split("; ")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("https://Lab.example.org:443", PUBLIC),
        ("http://[::1]:8770", "http://[::1]:8770"),
        *((wrong, None) for wrong in ("lab.example.org", "ftp://a", "https://", "https://a@b", "https://a:b", "null")),
        *((wrong, None) for wrong in ("https://a/b", "https://a?b", "https://a b", "https://a\\b", "https://a:99999")),
    ],
)
def test_an_origin_is_a_scheme_a_host_and_a_port(text, shown):
    origin = origin_of(text)
    assert (None if origin is None else str(origin)) == shown


@pytest.mark.parametrize(
    ("arguments", "tokens", "words"),
    [
        (("--host", "0.0.0.0"), {}, "expected a token in the variable ROBOGAUNTLET_TOKEN, got none"),
        (("--host", "0.0.0.0"), {"": "abc"}, "expected at least 16 characters with --host 0.0.0.0, got 3"),
        (("--public-url", PUBLIC), {}, f"--public-url {PUBLIC}: other machines can reach it"),
        (("--public-url", "lab.example.org/x"), {}, "expected an address such as https://lab.example.org"),
        ((), {"_READ": READ}, "expected ROBOGAUNTLET_TOKEN beside it"),
        ((), {"": READ, "_READ": READ}, "expected another token than ROBOGAUNTLET_TOKEN"),
        (("--host", "0.0.0.0"), {"": TOKEN, "_READ": "short"}, "ROBOGAUNTLET_TOKEN_READ: expected at least 16"),
    ],
)
def test_tokens_that_do_not_protect_are_refused(run_command, monkeypatch, tmp_path, arguments, tokens, words):
    for name in ("", "_READ"):
        monkeypatch.delenv(f"ROBOGAUNTLET_TOKEN{name}", raising=False)
    for name, token in tokens.items():
        monkeypatch.setenv(f"ROBOGAUNTLET_TOKEN{name}", token)
    history = f"sqlite:///{tmp_path}/runs/history.sqlite"
    assert words in run_command("serve", "--port", "0", "--history", history, *arguments).refusal
    assert not (tmp_path / "runs").exists()
