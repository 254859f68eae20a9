"""Telling by e-mail, to real SMTP servers: encrypted, with a login, refusing, gone."""

import email
import email.policy
import ssl

import pytest
import trustme
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.telling import Kind, Message, tell, tellers
from orchestrator.telling.mail import letter
from tests.orchestrator.told_servers import QUICK, Inbox, Users, certified, closed_port, greeter, smtp

MESSAGE = Message(Kind.REGRESSED, "REGRESSED: a against b", ("p: 85 % → 71 %",), "a", "runs/a/report.html")
PASSWORD = "correct-horse-battery"
LOGIN = {"GAUNTLET_SMTP_USER": "me", "GAUNTLET_SMTP_PASSWORD": PASSWORD}


@pytest.fixture(scope="module")
def authority():
    return trustme.CA()


@pytest.fixture
def trusting(authority):
    context = ssl.create_default_context()
    authority.configure_trust(context)
    return context


def environment(port, tls, **more):
    return {
        "GAUNTLET_SMTP_HOST": "localhost",
        "GAUNTLET_SMTP_PORT": str(port),
        "GAUNTLET_SMTP_TLS": tls,
        "GAUNTLET_MAIL_FROM": "Gauntlet <gauntlet@example.org>",
        "GAUNTLET_MAIL_TO": "a@example.org, Someone Else <b@example.org>",
        **more,
    }


def told(port, tls="none", context=None, **more):
    return tell(MESSAGE, tellers(environment(port, tls, **more), retries=QUICK, ssl_context=context))


def test_a_letter_arrives_with_its_subject_and_lines():
    inbox = Inbox()
    with smtp(inbox) as port:
        assert told(port) == []
    (envelope,) = inbox.letters
    assert envelope.mail_from == "gauntlet@example.org"
    assert envelope.rcpt_tos == ["a@example.org", "b@example.org"]
    mail = email.message_from_bytes(envelope.content, policy=email.policy.default)
    assert mail["Subject"] == "[gauntlet] REGRESSED: a against b"
    assert mail["From"] == "Gauntlet <gauntlet@example.org>"
    assert mail["To"] == "a@example.org, Someone Else <b@example.org>"
    assert mail["Message-ID"].endswith("@example.org>")
    assert mail.get_content().splitlines() == [
        *("REGRESSED: a against b", "", "- p: 85 % → 71 %", "", "run: a", "report: runs/a/report.html")
    ]


def test_by_starttls_the_login_and_the_letter_go_encrypted(authority, trusting):
    inbox = Inbox()
    options = {"tls_context": certified(authority), "require_starttls": True, "auth_required": True}
    with smtp(inbox, authenticator=Users("me", PASSWORD), **options) as port:
        assert told(port, "starttls", trusting, **LOGIN) == []
    assert inbox.encrypted == [True]


@pytest.mark.filterwarnings("ignore:Requiring AUTH while not requiring TLS")  # aiosmtpd knows of STARTTLS only
def test_by_tls_all_goes_encrypted(authority, trusting):
    inbox = Inbox()
    options = {"ssl_context": certified(authority), "auth_required": True, "auth_require_tls": False}
    with smtp(inbox, authenticator=Users("me", PASSWORD), **options) as port:
        assert told(port, "tls", trusting, **LOGIN) == []
    assert len(inbox.letters) == 1


def test_an_authority_can_be_named_in_the_environment(authority, tmp_path, monkeypatch):
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "ca.pem"))
    inbox = Inbox()
    with smtp(inbox, tls_context=certified(authority), require_starttls=True) as port:
        assert told(port, "starttls") == []
    assert inbox.encrypted == [True]


@pytest.mark.parametrize("tls", ["starttls", "tls"])
def test_a_certificate_of_nobody_known_is_not_accepted(authority, tls):
    inbox = Inbox()
    options = {"tls_context": certified(authority)} if tls == "starttls" else {"ssl_context": certified(authority)}
    with smtp(inbox, **options) as port:
        (line,) = told(port, tls, **LOGIN)
    assert "its certificate was not accepted: unable to get local issuer certificate; " in line
    assert "SSL_CERT_FILE" in line
    assert inbox.letters == []


def test_a_certificate_for_another_host_is_not_accepted(authority, trusting):
    inbox = Inbox()
    with smtp(inbox, tls_context=certified(authority, "elsewhere.example.org")) as port:
        (line,) = told(port, "starttls", trusting)
    assert "Hostname mismatch" in line
    assert inbox.letters == []


def test_a_server_without_starttls_is_told_nothing():
    inbox = Inbox()
    with smtp(inbox) as port:
        (line,) = told(port, "starttls", **LOGIN)
    assert line.startswith(f"could not tell of a: e-mail through localhost:{port} (starttls): cannot what it is asked")
    assert inbox.tries == 0


def test_a_wrong_password_is_told_once_and_not_repeated(authority, trusting):
    inbox = Inbox()
    options = {"tls_context": certified(authority), "require_starttls": True, "auth_required": True}
    with smtp(inbox, authenticator=Users("me", "another"), **options) as port:
        (line,) = told(port, "starttls", trusting, **LOGIN)
    assert "refused to let us in (535); check GAUNTLET_SMTP_USER and GAUNTLET_SMTP_PASSWORD" in line
    assert PASSWORD not in line


def test_a_server_that_is_busy_is_asked_again():
    inbox = Inbox(["451 4.3.0 busy"] * 3)
    with smtp(inbox) as port:
        assert told(port) == []
    assert inbox.tries == 4
    assert len(inbox.letters) == 1


def test_a_server_that_stays_busy_is_given_up_after_four_tries():
    inbox = Inbox(["451 4.3.0 busy"] * 9)
    with smtp(inbox) as port:
        (line,) = told(port)
    assert "refused the sender (451); check GAUNTLET_MAIL_FROM" in line
    assert line.endswith("(after 4 tries)")
    assert inbox.tries == 4


def test_a_server_that_says_no_is_not_asked_again():
    inbox = Inbox(["550 5.7.1 not you"] * 9)
    with smtp(inbox) as port:
        (line,) = told(port)
    assert "refused the sender (550)" in line
    assert inbox.tries == 1


def test_an_address_that_is_refused_is_told_by_its_place_and_the_others_get_the_letter():
    inbox = Inbox(unknown={"b@example.org"})
    with smtp(inbox) as port:
        (line,) = told(port)
    assert line.endswith("refused 1 of 2 addresses with 550; check number 2 in GAUNTLET_MAIL_TO")
    assert [one.rcpt_tos for one in inbox.letters] == [["a@example.org"]]


def test_when_all_addresses_are_refused_nothing_is_sent():
    inbox = Inbox(unknown={"a@example.org", "b@example.org"})
    with smtp(inbox) as port:
        (line,) = told(port)
    assert line.endswith("refused 2 of 2 addresses with 550; check number 1, 2 in GAUNTLET_MAIL_TO")
    assert inbox.letters == []


def test_who_is_not_there_is_told_in_a_line():
    (line,) = told(closed_port())
    assert line.endswith("connection refused; check GAUNTLET_SMTP_HOST and GAUNTLET_SMTP_PORT (after 4 tries)")
    (line,) = told(25, "starttls", GAUNTLET_SMTP_HOST="gauntlet.invalid")
    assert "no host has this name" in line


def test_a_server_that_does_not_speak_smtp_is_told_in_a_line():
    with greeter(b"hello there\r\n") as port:
        (line,) = told(port)
    assert "does not speak SMTP; check GAUNTLET_SMTP_PORT" in line


@given(st.text(), st.text(), st.lists(st.text(), max_size=3))
def test_no_name_can_become_a_header(title, run, lines):
    (teller,) = tellers(environment(25, "none"))
    inserted = f"{title}\r\nBcc: everybody@example.org\n\nbody {run}"
    made = letter(Message(Kind.TEST, inserted, (*lines, inserted), inserted), teller.sender, teller.recipients)
    back = email.message_from_bytes(bytes(made), policy=email.policy.default)
    assert (
        back.keys()
        == made.keys()
        == [
            *("Subject", "From", "To", "Date", "Message-ID", "Auto-Submitted", "X-Gauntlet-Kind"),
            *("Content-Type", "Content-Transfer-Encoding", "MIME-Version"),
        ]
    )
