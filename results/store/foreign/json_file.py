"""Result files in JSON: tells the formats apart."""

from __future__ import annotations

from typing import Any

from robogauntlet.results.store.foreign import lerobot, vla_eval
from robogauntlet.results.store.foreign.trials import BadResults, Results
from robogauntlet.support.json_text import parse_json
from robogauntlet.support.text import first_of, visible


def read_json(content: bytes, policy: str | None = None, task: str | None = None) -> Results:
    """Read a result file of LeRobot or vla-eval.

    Args:
        content: The file.
        policy: Name of the policy, which these files do not name.
        task: Task of a file that does not name it.

    Raises:
        BadResults: It is none, or has no trial; or the policy is not named.
    """
    try:
        value: Any = parse_json(content.decode("utf-8-sig"))
    except ValueError:
        raise _other("this is no JSON, or damaged") from None
    keys = list(value) if isinstance(value, dict) else []
    if any(key in value for key in lerobot.KEYS if keys):
        read = lerobot.read_lerobot
    elif all(key in keys for key in vla_eval.KEYS):
        read = vla_eval.read_vla_eval
    else:
        raise _other(f"this is something else, with {first_of([visible(key)[:40] for key in keys]) or 'no keys'}")
    if policy is None:
        raise BadResults("expected --policy NAME, since the file does not name the policy")
    results = read(value, policy, task)
    if not results.trials:
        raise BadResults("expected results with a trial, it has none")
    return results


def _other(reason: str) -> BadResults:
    return BadResults(f"expected results of lerobot-eval (eval_info.json) or vla-eval (*_aggregate.json): {reason}")
