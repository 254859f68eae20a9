"""The process in which a policy is checked, which ends with everything that code of the user has started there."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
from typing import Any

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.kit.policy.check import Probe, as_plain, findings_of, first_actions
from robogauntlet.policies.contract import Policy
from robogauntlet.support.child_process import serve
from robogauntlet.support.errors import UserError, describe


class _Checked:
    """The policy in its process."""

    policy: Policy
    probe: Probe

    def answer(self, request: Any) -> dict[str, Any]:
        """Build the policy, then answer `check` with findings, or `play` with the actions of the first episode."""
        try:
            if isinstance(request, dict):
                self._build(request)
                return {"answer": None}
            return {"answer": self._play(request)}
        except (UserError, AdapterError) as error:
            return {"error": str(error), "of_adapter": isinstance(error, AdapterError)}
        except BaseException as error:  # code of the user raises anything
            return {"error": f"it raised {describe(error)}", "of_adapter": False}

    def _build(self, request: dict[str, Any]) -> None:
        if request["path"] is not None:
            sys.path[:] = request["path"]
        probe = request["probe"]
        self.probe = Probe(**{**probe, "source": PolicySource(**probe["source"])})
        self.policy = build_policy(self.probe.source)

    def _play(self, request: str) -> Any:
        try:
            if request == "play":
                return first_actions(self.policy, self.probe).tolist()
            return [as_plain(found) for found in findings_of(self.policy, self.probe)]
        finally:
            if callable(close := getattr(self.policy, "close", None)):
                close()


if __name__ == "__main__":
    faulthandler.register(signal.SIGUSR1, all_threads=False)
    os.dup2(2, 1)
    serve(_Checked().answer)
    os._exit(0)  # whatever threads the code has started
