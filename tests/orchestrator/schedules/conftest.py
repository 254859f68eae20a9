"""An authority of certificates, which clients accept in tests that use `trusted`, and short waits."""

import pytest
import trustme


@pytest.fixture(scope="module")
def authority():
    return trustme.CA()


@pytest.fixture
def trusted(authority, tmp_path, monkeypatch):
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "ca.pem"))


@pytest.fixture(autouse=True)
def without_waits(monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.schedules.notifications.WAITS_S", (0.001, 0.001, 0.001))
