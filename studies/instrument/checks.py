"""What `check policy` says of a defect that it does not say of the reference: failures and warnings."""

from __future__ import annotations

import json
import subprocess
from typing import Any

from studies.instrument.draws import policies
from studies.instrument.instrument import DEFECTS
from studies.shared import GAUNTLET, table_of

TASK = "pybullet/PandaPickAndPlace-v3"
SEED = 30_000
LEVELS = ("failed", "warning")
CHECKED = ("bits-2", "noise-20", "delay-2", "flipped", "mirrored")
"""The largest grade of each defect."""
MISTAKES = {
    "state kept between episodes": {"delay": 1, "forgets": False},
    "translations from -1 to 1": {"unit": 0.03},
}
"""Mistakes of a convention, for which the check is made, as options of `defects.Defective`."""
COLUMNS = {"defect": "{defect}", "beyond the reference": "{found}"}


def measure() -> list[dict[str, Any]]:
    """A row for each defect and each mistake."""
    reference, *builds = policies()
    wrapped = next(entry for entry in builds if entry["kind"] == "python")
    builds = [entry for entry in builds if entry["name"] in CHECKED]
    builds += [
        {**wrapped, "name": name, "options": {**wrapped["options"], "options": options}}
        for name, options in MISTAKES.items()
    ]
    usual = set(_findings(reference))
    said: dict[str, list[str]] = {}
    for build in builds:
        found = [text for text in _findings(build) if text not in usual]
        said.setdefault("; ".join(found) or "nothing", []).append(DEFECTS.get(build["name"], build["name"]))
        print(build["name"], found, flush=True)
    rows = [{"defect": ", ".join(names), "found": found} for found, names in said.items()]
    table_of(rows, COLUMNS)
    return rows


def _findings(entry: dict[str, Any]) -> list[str]:
    options = [f"--option={name}={json.dumps(value)}" for name, value in entry["options"].items()]
    command = [*GAUNTLET, "check", "policy", entry["kind"], "--task", TASK, "--seed", str(SEED), "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise RuntimeError(done.stderr)
    found = [one for one in json.loads(done.stdout)["findings"] if one["level"] in LEVELS]
    return [f"{one['level']}, {one['topic']}: {one['text']}" for one in found]
