"""Looks up known vulnerabilities of everything that RoboGauntlet pins, by pip-audit: `make audit`.

That is constraints.txt, and what an environment for LeRobot gets. Exit codes: 0 none is known, 1 at least one is, 3 the
service did not answer for all of them, so that nothing is known.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
ACCEPTED: dict[str, str] = {}
"""Identifier of a vulnerability to the reason why it does not concern what we do with the package."""


def main(program: Sequence[str]) -> int:
    """Audit the pins and print what was found.

    Args:
        program: The command `pip-audit`.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pins.txt"
        status = 0
        for name, pins in pins_by_origin().items():
            file.write_text("".join(f"{pin}\n" for pin in pins))
            # The pins are complete: nothing is resolved, so that nothing is installed either.
            options = ["--no-deps", "--disable-pip", "--progress-spinner", "off", "--format", "json"]
            options += [word for accepted in ACCEPTED for word in ("--ignore-vuln", accepted)]
            command = [*program, *options, "--requirement", str(file)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            lines, code = judge(name, done.stdout, done.stderr)
            print("\n".join(lines))
            # A vulnerability that was found outweighs one that may not have been.
            status = 1 if 1 in (status, code) else max(status, code)
    return status


def pins_by_origin() -> dict[str, list[str]]:
    """Where pins stand to `name==version` of each."""
    from robogauntlet.policies.lerobot.policy import KIND

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return {
        "constraints.txt": [line for line in lines if line and not line.startswith("#")],
        "policies/lerobot/policy.py": [pin for pin in (*KIND.requirements, *KIND.without_dependencies) if "==" in pin],
        "policies/lerobot/policy.py, preferred": sorted({pin for pins in KIND.preferred.values() for pin in pins}),
    }


def judge(name: str, output: str, errors: str) -> tuple[list[str], int]:
    """The lines to print about one list of pins, and its exit code."""
    try:
        packages = json.loads(output)["dependencies"]
    except (ValueError, KeyError):
        last = (errors.strip().splitlines() or ["no output"])[-1]
        return [f"{name}: NOT CHECKED, pip-audit could not reach its vulnerability service: {last}"], 3
    if found := list(_findings(packages)):
        return [f"{name}: {len(found)} known vulnerabilities", *(f"  {line}" for line in found)], 1
    if unknown := [package["name"] for package in packages if "skip_reason" in package]:
        answer = f"the vulnerability service answered for {len(packages) - len(unknown)} of {len(packages)} packages"
        return [f"{name}: NOT CHECKED, {answer}; not for {', '.join(unknown[:3])}{', ...' * (len(unknown) > 3)}"], 3
    return [f"{name}: no known vulnerability in {len(packages)} packages"], 0


def _findings(packages: Iterable[dict[str, Any]]) -> Iterator[str]:
    for package in packages:
        for hole in package.get("vulns", ()):
            fixed = ", ".join(hole["fix_versions"]) or "no version"
            names = ", ".join([hole["id"], *hole.get("aliases", ())])
            yield f"{package['name']} {package['version']}: {names}; fixed in {fixed}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["pip-audit"]))
