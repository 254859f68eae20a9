"""Telling by webhook, to real servers that fail first, say no, hang up or are not there."""

import pytest
import trustme
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.telling import Kind, Message, tell, tellers
from orchestrator.telling.webhook import MOST_SECTIONS, escaped, pack, payload
from tests.orchestrator.told_servers import QUICK, Hook, certified, closed_port

MESSAGE = Message(Kind.REGRESSED, "REGRESSED: a against b", ("one & two", "<!channel>"), "a", "https://lab/a?x=1&y=2")


def told(url):
    return tell(MESSAGE, tellers({"GAUNTLET_WEBHOOK_URL": url}, retries=QUICK))


def test_what_arrives_is_json_that_slack_takes():
    with Hook() as hook:
        assert told(hook.url) == []
    (came,) = hook.came
    assert came["text"].splitlines() == [
        "*REGRESSED: a against b*",
        "• one &amp; two",
        "• &lt;!channel&gt;",
        "run: a",
        "report: https://lab/a?x=1&amp;y=2",
    ]
    header, section, context = came["blocks"]
    assert header == {"type": "header", "text": {"type": "plain_text", "text": "REGRESSED: a against b"}}
    assert section["text"]["text"] == "• one &amp; two\n• &lt;!channel&gt;"
    assert [one["text"] for one in context["elements"]] == ["run: a", "<https://lab/a?x=1&amp;y=2|report>"]


@pytest.mark.parametrize("failure", [429, 500, 502, 503, 504, "hang up"])
def test_what_may_pass_is_tried_again_until_it_works(failure):
    with Hook([failure] * 3) as hook:
        assert told(hook.url) == []
    assert len(hook.came) == 4
    assert all(one == hook.came[0] for one in hook.came)


@pytest.mark.parametrize("asked", ["0", "1.5", "soon", "9" * 5000, "Thu, 01 Jan 1970 00:00:00 GMT"])
def test_whatever_a_server_asks_to_wait_it_is_tried_again(asked):
    with Hook([429], {"Retry-After": asked} if len(asked) < 5000 else {"Retry-After": "0"}) as hook:
        assert told(hook.url) == []
    assert len(hook.came) == 2


def test_a_wait_that_is_asked_for_is_kept_up_to_the_longest():
    retry = QUICK.retry()
    assert retry.respect_retry_after_header
    assert retry.parse_retry_after("1") == 1
    assert retry.parse_retry_after("86400") == QUICK.longest_wait_s


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (429, "answered 429, too many messages, after 4 tries; tell less often, or wait"),
        (503, "answered 503, it is out of order, after 4 tries; wait, or see whether the service is down"),
        ("hang up", "it closed the connection without an answer, after 4 tries; check that the host is up"),
        ("no http", "what it answered is not HTTP, after 4 tries; check that the host is up"),
    ],
)
def test_after_four_tries_it_is_given_up_with_what_came(status, words):
    with Hook([status] * 4) as hook:
        (line,) = told(hook.url)
    assert line.startswith(f"could not tell of a: webhook (http://localhost): {words}")
    assert len(hook.came) == 4


@pytest.mark.parametrize(
    ("status", "words"),
    [
        ("invalid_payload", "answered 400 (invalid_payload): it does not take Slack's JSON as it was sent"),
        ("something else", "answered 400: it does not take Slack's JSON as it was sent"),
        (404, "answered 404: messages are not (or no longer) taken at this address; make a new webhook"),
        (302, "answered 302, a redirection, which is not followed"),
    ],
)
def test_what_will_not_pass_is_tried_once(status, words):
    with Hook([status], {"Location": "/elsewhere"} if status == 302 else ()) as hook:
        (line,) = told(hook.url)
    assert line.startswith(f"could not tell of a: webhook (http://localhost): {words}")
    assert "GAUNTLET_WEBHOOK_URL" in line
    assert len(hook.came) == 1


def test_who_is_not_there_is_told_from_a_host_that_does_not_exist():
    (refused,) = told(f"http://localhost:{closed_port()}/x")
    assert "connection refused, after 4 tries" in refused
    (unknown,) = told("http://gauntlet.invalid/x")
    assert "no host has this name, or no name server was reached, after 4 tries" in unknown


def test_a_certificate_is_checked(tmp_path, monkeypatch):
    authority = trustme.CA()
    with Hook(tls=certified(authority)) as hook:
        (line,) = told(hook.url)
        assert "its certificate was not accepted: " in line
        assert hook.came == []
        authority.cert_pem.write_to_path(tmp_path / "ca.pem")
        monkeypatch.setenv("REQUESTS_CA_BUNDLE", str(tmp_path / "ca.pem"))
        assert told(hook.url) == []
    assert len(hook.came) == 1


def test_a_server_without_tls_is_told_from_one_that_is_down():
    with Hook() as hook:
        (line,) = told(hook.url.replace("http://", "https://"))
    assert "it does not speak TLS, or another version of it" in line


TEXT = st.text(st.sampled_from("ab &<>|\n•é😀"), max_size=4000)


@given(TEXT, st.lists(TEXT, max_size=60), TEXT, st.none() | TEXT | TEXT.map("https://lab/".__add__))
def test_whatever_is_told_keeps_to_the_limits_of_slack(title, lines, run, link):
    made = payload(Message(Kind.STOPPED, title, tuple(lines), run, link))
    assert 0 < len(made["text"]) <= 4000
    assert len(made["blocks"]) <= 50
    for block in made["blocks"]:
        for text in block.get("elements", [block.get("text")]):
            assert 0 < len(text["text"]) <= (150 if block["type"] == "header" else 3000)


@given(TEXT, st.integers(1, 200))
def test_no_sign_of_slacks_own_is_left_and_no_entity_is_cut(text, limit):
    made = escaped(text, limit)
    assert len(made) <= limit
    assert "<" not in made
    assert ">" not in made
    back = made.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    assert text.startswith(back.removesuffix("…"))
    assert made.count("&") == sum(made.count(entity) for entity in ("&lt;", "&gt;", "&amp;"))


def test_lines_that_do_not_fit_are_counted():
    chunks = pack([f"line {n} {'x' * 100}" for n in range(1000)], 3000, MOST_SECTIONS)
    assert len(chunks) == MOST_SECTIONS
    shown = sum(chunk.count("line ") for chunk in chunks)
    assert chunks[-1].endswith(f"… and {1000 - shown:,} lines more")


def test_no_line_that_fits_is_left_out():
    lines = [f"line {n}" for n in range(500)]
    assert "\n".join(pack(lines, 3000, MOST_SECTIONS)).splitlines() == lines
