"""The environment variables that are secret, and environments for processes that need none of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping

SERVER_SECRETS = (
    "ROBOGAUNTLET_TOKEN",
    "ROBOGAUNTLET_TOKEN_READ",
    "ROBOGAUNTLET_SMTP_USER",
    "ROBOGAUNTLET_SMTP_PASSWORD",
    "ROBOGAUNTLET_WEBHOOK_URL",
)
"""Secrets of the dashboard, of policy servers and of notifications."""
TRACKER_SECRETS = {
    "wandb": ("WANDB_API_KEY",),
    "mlflow": tuple(f"MLFLOW_TRACKING_{name}" for name in ("URI", "USERNAME", "PASSWORD", "TOKEN")),
}
"""Experiment tracker to its secrets; the address of MLflow may hold a password."""
RUN_SECRETS = (
    *("ROBOGAUNTLET_STORE", "ROBOGAUNTLET_HISTORY", "PGPASSWORD"),
    *(name for names in TRACKER_SECRETS.values() for name in names),
)
"""Secrets that a run's own process needs: URLs of databases, which may hold passwords, and experiment trackers."""
SECRETS = (*SERVER_SECRETS, *RUN_SECRETS)
"""All but the tokens of policies."""
POLICY_TOKEN = "ROBOGAUNTLET_POLICY_TOKEN"
"""The token of a policy server; with a suffix, of one of several. Workers have them, since they query the servers."""


def without_secrets(environment: Mapping[str, str], *, but: Collection[str] = ()) -> dict[str, str]:
    """Return the variables for a process that needs no secret, `but` these."""
    return {name: value for name, value in environment.items() if name in but or not is_secret(name)}


def is_secret(name: str) -> bool:
    """Whether a variable is a secret or a policy's token."""
    return name in SECRETS or name == POLICY_TOKEN or name.startswith(f"{POLICY_TOKEN}_")
