"""The tables of a study: `python -m studies NAME` prints them from the rows that are kept.

`--measure TABLE...` measures tables again into runs/bench (without a table: those of `QUICK`), `--keep TABLE...` copies
what was measured into the study, and `--write` brings the tables of its README up to date. Without a name all studies
are listed. With PERCENT=1 in the environment a hundredth is measured, which shows whether a measurement goes through.
"""

import argparse
import importlib
import json
import os
import subprocess
import sys

from studies.percent import LACKING
from studies.tables import NAMES, WRITTEN, PartMeasured, keep, markdown, readme, tables_of, with_tables, write

CODE = """
import json, sys
from studies.{study} import {name} as measurement
from studies import shared
try:
    rows = measurement.measure()
except shared.Lacking as reason:
    print(f"{name}: {{reason}}", file=sys.stderr)
    sys.exit({lacking})
print("measured:" + json.dumps({{"columns": shared.COLUMNS, "rows": rows}}))
"""


def main() -> None:
    """List the studies, or print, measure, keep or write the tables of one."""
    parser = argparse.ArgumentParser(prog="python -m studies", description=__doc__.partition("\n\n")[0])
    parser.add_argument("study", nargs="?", choices=NAMES)
    parser.add_argument("--measure", nargs="*", metavar="TABLE", help="measure these tables again; takes up to hours")
    parser.add_argument("--keep", nargs="+", metavar="TABLE", help="copy what was measured into the study")
    parser.add_argument("--write", action="store_true", help="write the tables into the README")
    wanted = parser.parse_args()
    if wanted.study is None:
        print("\n".join(f"{name:16} {title(name)}" for name in NAMES))
        return
    known = {path.stem for path in readme(wanted.study).parent.glob("[a-z]*.py")} | set(tables_of(wanted.study))
    if unknown := [name for name in (*(wanted.measure or ()), *(wanted.keep or ())) if name not in known]:
        parser.error(f"expected a table of {wanted.study} ({', '.join(tables_of(wanted.study))}), got '{unknown[0]}'")
    try:
        for name in wanted.keep or ():
            keep(wanted.study, name)
    except PartMeasured as refused:
        print(refused, file=sys.stderr)
        sys.exit(2)
    if wanted.measure is not None:
        measure(wanted.study, wanted.measure)
    elif wanted.write or wanted.keep:
        page = readme(wanted.study)
        page.write_text(with_tables(wanted.study, page.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        for name in tables_of(wanted.study):
            print(f"\n== {name}\n", *markdown(wanted.study, name), sep="\n")


def title(study: str) -> str:
    """The first line of a study's page."""
    return readme(study).read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def measure(study: str, names: list[str]) -> None:
    """Run each measurement in its own process, so that they do not share memory or threads."""
    of = importlib.import_module(f"studies.{study}")
    for name in names or of.QUICK:
        print(f"\n== {name}", flush=True)
        code = CODE.format(study=study, name=name, lacking=LACKING)
        python, variables = interpreter(getattr(of, "APART", {}).get(name))
        process = subprocess.Popen([python, "-c", code], stdout=subprocess.PIPE, text=True, env=variables)
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("measured:"):
                write(name, json.loads(line.removeprefix("measured:")))
            else:
                print(line, end="", flush=True)
        if status := process.wait():
            sys.exit(LACKING if status == LACKING else f"{name} failed")
    print(f"\nwritten to {WRITTEN}/")


def interpreter(simulator: str | None) -> tuple[str, dict[str, str]]:
    """Interpreter and variables of a process, in the environment of a simulator if one is named."""
    if simulator is None:
        return sys.executable, dict(os.environ)
    from robogauntlet.adapters import catalog
    from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver

    resolver, found = EnvironmentResolver({}), catalog.find(simulator)
    if reason := resolver.missing_reason(found):
        print(reason, file=sys.stderr)
        sys.exit(LACKING)
    return resolver.subprocess_env(found)


main()
