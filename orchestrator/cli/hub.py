"""Pushes an exported folder to the Hugging Face hub, through huggingface_hub if it is installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robogauntlet.results.report.hub_folder import CARD
from robogauntlet.support.errors import BadInput


def check_repository(name: str) -> None:
    """Raise BadInput unless huggingface_hub is installed and this is the name of a repository. Nothing is contacted."""
    _api()
    from huggingface_hub.utils import HFValidationError, validate_repo_id

    try:
        validate_repo_id(name)
    except HFValidationError:
        valid = False
    else:
        valid = name.count("/") == 1
    if not valid:
        raise BadInput(f"--push: expected USER/NAME of letters, digits and . _ -, got {name!r}")


def push_folder(folder: Path, name: str, kind: str) -> str:
    """Push a folder to a repository of the type `kind` and return the address.

    A new repository is private. If it has a card already, a pull request is opened, so that no card is overwritten.

    Raises:
        BadInput: The hub refuses, or cannot be reached.
    """
    api = _api()
    try:
        api.create_repo(name, repo_type=kind, private=True, exist_ok=True)
        has_card = api.file_exists(name, CARD, repo_type=kind)
        message = "Add results of RoboGauntlet"
        pushed = api.upload_folder(
            repo_id=name, folder_path=folder, repo_type=kind, commit_message=message, create_pr=has_card
        )
        return str(pushed.pr_url or pushed.repo_url)
    except Exception as error:  # its text may contain addresses with a token
        problem = type(error).__name__
    raise BadInput(
        f"{name}: the hub did not accept {folder} ({problem}); log in with `hf auth login`, or set HF_TOKEN, "
        "remove the folder and try again"
    )


def _api() -> Any:
    try:
        from huggingface_hub import HfApi
    except ImportError:
        raise BadInput(
            "--push: huggingface_hub is not installed; install it with: pip install huggingface_hub"
        ) from None
    return HfApi()
