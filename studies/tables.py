"""Copies measurements into the documentation: `python -m tests.benchmarks.document frames control_step`.

Pages show the table of `docs/measurements/NAME.json` between `<!-- measured: NAME -->` and `<!-- end -->`.
"""

import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas as pd

from tests import ROOT

PAGES = sorted((ROOT / "docs").glob("*.md"))
MEASUREMENTS = ROOT / "docs/measurements"
WRITTEN = ROOT / "runs/bench"
"""Where benchmarks write what they measured."""
PACKAGES = ("mujoco", "robosuite", "sapien", "mani-skill", "pybullet", "torch", "ray")
END = "<!-- end -->"
BLOCK = re.compile(rf"(<!-- measured: (\w+) -->\n).*?{END}", re.DOTALL)


def machine() -> str:
    """Cores and model of the processor, and the GPU if there is one."""
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    count = len(os.sched_getaffinity(0))
    cores = f"{count} core{'s' * (count > 1)} of {model[1] if model else platform.processor()}"
    if shutil.which("nvidia-smi") is None:
        return cores
    query = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
    asked = subprocess.run(query, capture_output=True, text=True)
    return ", ".join([cores, *asked.stdout.splitlines()]) if asked.returncode == 0 else cores


def write(name: str, measured: Mapping[str, Any]) -> None:
    """Write a measurement with its date, machine, and the versions of the simulators and of what plays them."""
    installed = {package.name.replace("_", "-") for package in metadata.distributions() if package.name}
    versions = {package: metadata.version(package) for package in PACKAGES if package in installed}
    result = {"date": str(date.today()), "machine": machine(), "versions": versions, **measured}
    WRITTEN.mkdir(parents=True, exist_ok=True)
    (WRITTEN / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")


def write_episodes(name: str, frame: pd.DataFrame, order: Sequence[str]) -> None:
    """Write the episodes behind a measurement beside it, ordered by these columns."""
    WRITTEN.mkdir(parents=True, exist_ok=True)
    frame.sort_values(list(order)).to_parquet(WRITTEN / f"{name}.parquet", index=False)


def markdown(name: str) -> Iterator[str]:
    """Lines of a measurement's table, and of how it was made."""
    measured = json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))
    columns: dict[str, str] = measured["columns"]
    cells = [[text.format(**row) for text in columns.values()] for row in measured["rows"]]
    yield from (f"| {' | '.join(line)} |" for line in (columns, ["---"] * len(columns), *cells))
    versions = ", ".join(f"{package} {version}" for package, version in measured["versions"].items())
    command = measured.get("command", f"python -m tests.benchmarks {name}")
    yield from ("", f"`{command}`, {measured['date']}; {measured['machine']}; {versions}.")


def with_measurements(text: str) -> str:
    """The page with all its blocks as the committed measurements have them."""
    return BLOCK.sub(lambda found: "\n".join((found[1], *markdown(found[2]), "", END)), text)


if __name__ == "__main__":
    MEASUREMENTS.mkdir(exist_ok=True)
    for benchmark in sys.argv[1:]:
        for file in WRITTEN.glob(f"{benchmark}.*"):  # rows, and what they are made from or shown in
            shutil.copy(file, MEASUREMENTS)
    for page in PAGES:
        page.write_text(with_measurements(page.read_text(encoding="utf-8")), encoding="utf-8")
