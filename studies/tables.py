"""Tables of studies: written by measurements, kept as rows, shown in the README of each study.

A study is a folder with a README; `rows/NAME.json` has the rows of a table and how its columns are written, and
`rows/NAME.parquet`, where there is one, the episodes that they count. The module `NAME` of the study makes both. The
README shows the table between `<!-- table: NAME -->` and `<!-- end -->`.
"""

import importlib
import json
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas as pd

from robogauntlet.results.statistics.rates import wilson_interval
from studies.percent import PERCENT, SUFFIX

STUDIES = Path(__file__).parent
ROOT = STUDIES.parent
WRITTEN = ROOT / f"runs/bench{SUFFIX}"
"""Where measurements are written."""
NAMES = sorted(path.parent.name for path in STUDIES.glob("*/README.md"))
PACKAGES = ("mujoco", "robosuite", "sapien", "mani-skill", "pybullet", "torch", "ray")
SUCCESS = "success"
"""The table of a kept report, which has no module of its own."""
END = "<!-- end -->"
BLOCK = re.compile(rf"(<!-- table: (\w+) -->\n).*?{END}", re.DOTALL)


class PartMeasured(Exception):
    """A share of a measurement was to be kept."""


def kept(study: str, name: str) -> dict[str, Any]:
    """A table as it is kept: columns, rows, date, machine, versions."""
    return json.loads((STUDIES / study / f"rows/{name}.json").read_text(encoding="utf-8"))


def episodes_of(study: str, name: str) -> pd.DataFrame:
    """The kept episodes behind a table."""
    return pd.read_parquet(STUDIES / study / f"rows/{name}.parquet")


def tables_of(study: str) -> list[str]:
    """Names of a study's tables, in the order of its README."""
    return [name for _, name in BLOCK.findall(readme(study).read_text(encoding="utf-8"))]


def readme(study: str) -> Path:
    """The page of a study."""
    return STUDIES / study / "README.md"


def counted(study: str, name: str) -> list[dict[str, Any]]:
    """The rows of a table, counted again in the kept episodes or decisions where its module does so (`counted`)."""
    if name == SUCCESS:
        return success(study)
    rows: list[dict[str, Any]] = kept(study, name)["rows"]
    if not (STUDIES / study / f"{name}.py").exists():
        return rows
    module = importlib.import_module(f"studies.{study}.{name}")
    if hasattr(module, "counted"):
        return module.counted(rows)
    if hasattr(module, "rows_of") and (STUDIES / study / f"rows/{name}.parquet").exists():
        return module.rows_of(episodes_of(study, name))
    return rows


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
    result |= {"percent": PERCENT} if SUFFIX else {}
    WRITTEN.mkdir(parents=True, exist_ok=True)
    (WRITTEN / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")


def write_episodes(name: str, frame: pd.DataFrame, order: Sequence[str]) -> None:
    """Write the episodes behind a measurement beside it, ordered by these columns."""
    WRITTEN.mkdir(parents=True, exist_ok=True)
    frame.sort_values(list(order)).to_parquet(WRITTEN / f"{name}.parquet", index=False)


def keep(study: str, name: str) -> None:
    """Copy what was measured last into the study: rows, episodes, figures. Raises PartMeasured for a share of it."""
    if SUFFIX:
        raise PartMeasured(f"--keep {name}: expected a whole measurement, got PERCENT={PERCENT}: measure without it")
    for file in WRITTEN.glob(f"{name}.*"):
        shutil.copy(file, STUDIES / study / "rows")


def markdown(study: str, name: str) -> Iterator[str]:
    """Lines of a table, and of how it was made."""
    of = kept(study, name)
    columns: dict[str, str] = of["columns"]
    cells = [[text.format(**row) for text in columns.values()] for row in counted(study, name)]
    yield from (f"| {' | '.join(line)} |" for line in (columns, ["---"] * len(columns), *cells))
    versions = ", ".join(f"{package} {version}" for package, version in of["versions"].items())
    command = of.get("command", f"python -m studies {study} --measure {name}")
    yield from ("", f"`{command}`, {of['date']}; {of['machine']}; {versions}.")


def with_tables(study: str, text: str) -> str:
    """A page with all its tables as the kept rows have them."""
    return BLOCK.sub(lambda found: "\n".join((found[1], *markdown(study, found[2]), "", END)), text)


def success(study: str) -> list[dict[str, Any]]:
    """Success by condition and policy in the episodes of a study's kept report, with Wilson's interval, errors apart.

    Combinations of axes count together, by simulator. They have no interval, since episodes of one point are alike.
    """
    frame = pd.read_parquet(STUDIES / study / "report/episodes.parquet")
    combined = frame["axis"].str.contains("@").any()
    names = frame["axis"].where(frame["severity"] == 0, frame["axis"] + "@" + frame["severity"].astype(str))
    if combined:
        names = frame["simulator"].astype(str) + ", " + frame["axis"].where(frame["axis"] == "clean", "combinations")
    outcomes = frame["status"].map({"success": 1.0, "failure": 0.0})
    rows = []
    for name, played in outcomes.groupby(names):
        row = {"condition": str(name)} | dict.fromkeys(sorted(frame["policy"].unique().astype(str)), "")
        for policy, its in played.groupby(frame["policy"]):
            won, count = int(its.sum()), int(its.count())
            ends = wilson_interval(won, count)
            row[str(policy)] = f"{won} of {count}"
            if ends and not combined:
                row[str(policy)] = f"{100 * won / count:.0f} % [{100 * ends.low:.0f}, {100 * ends.high:.0f}]"
        rows.append(row)
    return rows
