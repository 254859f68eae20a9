"""No secret appears in a message, a log, an exception or a repr, whatever fails."""

import base64
import contextlib
import logging
import string
import traceback

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from robogauntlet.orchestrator.schedules.notifications import Message, send_all, targets
from robogauntlet.support.errors import BadInput
from tests.orchestrator.schedules.servers import Hook, Inbox, Users, certified, closed_port, greeter, smtp

MESSAGE = Message("a test", ("one",), "demo")
IN_A_PATH = string.ascii_letters + string.digits + "-._~!$'()*+,;=:@%"
MARK = "s3cr3t"
"""In every secret, so that a part of one is found as well, and nothing else is taken for one."""
SECRET = st.text(string.ascii_letters + string.digits + "-._~").map(MARK.__add__)
PATH = st.text(IN_A_PATH).map(MARK.__add__)
PASSWORD = st.text(string.printable.strip() + " ").map(lambda text: f"{MARK}{text}{MARK}")
MAIL = {
    "ROBOGAUNTLET_SMTP_HOST": "localhost",
    "ROBOGAUNTLET_MAIL_FROM": "robogauntlet@example.org",
    "ROBOGAUNTLET_MAIL_TO": "lab@example.org",
}
few = settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])


@contextlib.contextmanager
def logged():
    """Every record that any logger makes, as text, with nothing held back."""
    texts = []

    class Keep(logging.Handler):
        def emit(self, record):
            if record.name.startswith(("mail", "asyncio")):
                return  # the server's own
            texts.append(f"{record.getMessage()} {record.args!r} {record.exc_info!r} {record.__dict__!r}")

    keep, root = Keep(0), logging.getLogger()
    level = root.level
    root.addHandler(keep)
    root.setLevel(0)
    try:
        yield texts
    finally:
        root.removeHandler(keep)
        root.setLevel(level)


def assert_hidden(secret, *texts):
    shown = "\n".join(texts)
    assert MARK not in shown.lower()
    for form in (base64.b64encode(secret.encode()), base64.b64encode(f"\0me\0{secret}".encode())):
        assert form.decode() not in shown


def chain(error):
    """An exception and all that led to it, as texts."""
    found = traceback.format_exception(error)
    while error is not None:
        found += [str(error), repr(error), repr(error.args), repr(vars(error))]
        error = error.__cause__ or error.__context__
    return found


def notify(environment, secret):
    """Send a notification, and check that the secret is in nothing that is visible."""
    found = targets(environment)
    with logged() as texts:
        lines = send_all(MESSAGE, found)
    assert_hidden(secret, *lines, *texts, repr(found), str(found), *(one.name for one in found))
    return lines


@pytest.fixture(scope="module")
def hostile():
    """A server that repeats the address in its status line, its headers and its answer."""
    with Hook(echo=True) as hook:
        yield hook


@few
@given(PATH, st.sampled_from(["/{}", "/services/{}/x", "/x?token={}", "/x?{}"]), st.integers(300, 599))
def test_an_address_is_not_repeated_from_a_server_that_repeats_it(hostile, secret, place, status):
    hostile.script = [status] * 4
    url = f"http://localhost:{hostile.server_address[1]}{place.format(secret)}"
    assert notify({"ROBOGAUNTLET_WEBHOOK_URL": url}, secret)


@few
@given(SECRET, st.sampled_from(["hang up", "no http"]))
def test_an_address_is_not_repeated_when_a_connection_breaks(hostile, secret, way):
    hostile.script = [way] * 4
    assert notify({"ROBOGAUNTLET_WEBHOOK_URL": f"http://localhost:{hostile.server_address[1]}/{secret}"}, secret)
    hostile.script = []


@few
@given(SECRET, st.sampled_from(["http", "https"]), st.sampled_from(["localhost", "robogauntlet.invalid"]))
def test_an_address_is_not_repeated_when_the_connection_is_refused(secret, scheme, host):
    assert notify({"ROBOGAUNTLET_WEBHOOK_URL": f"{scheme}://{host}:{closed_port()}/{secret}?{secret}"}, secret)


def test_an_address_is_not_repeated_by_a_certificate_that_is_not_accepted(authority):
    with Hook(tls=certified(authority)) as hook:
        assert notify({"ROBOGAUNTLET_WEBHOOK_URL": hook.url}, "s3cr3t")


def test_an_address_is_not_logged_after_a_success(hostile):
    hostile.script = [503, 200]
    assert notify({"ROBOGAUNTLET_WEBHOOK_URL": hostile.url}, "s3cr3t") == []


def test_the_password_of_a_proxy_is_not_repeated(monkeypatch):
    monkeypatch.setenv("NO_PROXY", "")
    monkeypatch.setenv("HTTP_PROXY", f"http://me:{MARK}@localhost:{closed_port()}")
    (line,) = notify({"ROBOGAUNTLET_WEBHOOK_URL": f"http://robogauntlet.invalid/{MARK}"}, MARK)
    assert "connection refused" in line


@pytest.fixture
def echoing(authority, trusted):
    """An SMTP server that refuses every login, and repeats the password."""
    options = {"tls_context": certified(authority), "require_starttls": True, "auth_required": True}
    with smtp(Inbox(), authenticator=Users("someone", "something"), **options) as port:
        yield port


def mail_with_login(user, password, port):
    names = ("ROBOGAUNTLET_SMTP_USER", "ROBOGAUNTLET_SMTP_PASSWORD", "ROBOGAUNTLET_SMTP_PORT")
    return MAIL | dict(zip(names, (user, password, str(port)), strict=True))


@few
@given(PASSWORD)
def test_a_password_is_not_repeated_from_a_server_that_repeats_it(echoing, secret):
    (line,) = notify(mail_with_login("me", secret, echoing), secret)
    assert "answered 535" in line or "SMTPServerDisconnected" in line or "UnicodeEncodeError" in line


@few
@given(SECRET, st.sampled_from([b"220 {}\r\n", b"421 {}\r\n", b"554 {}\r\n", b"{}\r\n", b"{}"]))
def test_a_password_is_not_repeated_from_a_servers_greeting(secret, greeting):
    with greeter(greeting.replace(b"{}", secret.encode())) as port:
        assert notify(mail_with_login(secret, secret, port), secret)


@few
@given(SECRET, st.sampled_from(["starttls", "tls", "none"]))
def test_a_password_is_not_repeated_when_the_connection_is_refused(secret, tls):
    environment = mail_with_login(secret, secret, closed_port()) | {"ROBOGAUNTLET_SMTP_TLS": tls}
    assert notify(environment, secret)


VARIABLES = (
    *("ROBOGAUNTLET_SMTP_HOST", "ROBOGAUNTLET_SMTP_PORT", "ROBOGAUNTLET_SMTP_USER", "ROBOGAUNTLET_SMTP_PASSWORD"),
    *("ROBOGAUNTLET_SMTP_TLS", "ROBOGAUNTLET_MAIL_FROM", "ROBOGAUNTLET_MAIL_TO"),
)
URLS = (
    *("{}", "ftp://host/{}", "https://[{}/x", "https://host:{}/x", "https:///{}"),
    *("https://me:{}@host/x", "//{}", "https://\\{}/x"),
)


@given(PASSWORD, st.dictionaries(st.sampled_from(VARIABLES), st.booleans()), st.sampled_from(URLS))
def test_malformed_variables_are_named_without_their_values(secret, wrong, url):
    """A secret may be in the wrong variable, so values are not shown."""
    environment = MAIL | {name: secret if whole else f"x\n{secret}@" for name, whole in wrong.items()}
    environment["ROBOGAUNTLET_WEBHOOK_URL"] = url.replace("{}", secret)
    with logged() as texts, pytest.raises(BadInput, match=r"^ROBOGAUNTLET_") as raised:
        targets(environment)
    assert_hidden(secret, *chain(raised.value), *texts)


@given(st.text(min_size=1), st.text(), st.text(), st.text())
def test_a_wrong_configuration_raises_only_bad_input(url, host, sender, recipients):
    names = ("ROBOGAUNTLET_WEBHOOK_URL", "ROBOGAUNTLET_SMTP_HOST", "ROBOGAUNTLET_MAIL_FROM", "ROBOGAUNTLET_MAIL_TO")
    with contextlib.suppress(BadInput):
        targets(dict(zip(names, (url, host, sender, recipients), strict=True)))
