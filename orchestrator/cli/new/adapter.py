"""`robogauntlet new adapter`: create the package of a new adapter."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli.common import print_line
from robogauntlet.orchestrator.kit.scaffold import ADAPTER, BENCHMARK
from robogauntlet.support.errors import BadInput
from robogauntlet.support.json_text import parse_json


def new(
    name: Annotated[str, typer.Argument(help="Name of the simulator, such as mysim.")],
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to create; by default robogauntlet-NAME.")
    ] = None,
    benchmark: Annotated[
        str | None,
        typer.Option(
            "--vla-eval",
            metavar="MODULE:CLASS",
            help="A StepBenchmark of vla-evaluation-harness, whose tasks are opened and listed.",
        ),
    ] = None,
    arguments: Annotated[str, typer.Option(help="Arguments of that class, as JSON.")] = "{}",
    control_hz: Annotated[
        float | None, typer.Option(min=0.1, max=1000.0, help="Its control steps per simulated second.")
    ] = None,
) -> None:
    """Create the package of a new adapter.

    The package works from the start: with a toy simulation that you replace piece by piece, or with the tasks of a
    benchmark, which has to be installed in this Python.
    """
    folder = out_folder or Path(f"robogauntlet-{name}")
    if name in catalog.simulators():
        raise BadInput(f"the simulator '{name}' exists already; choose another name")
    if benchmark is None and (control_hz is not None or arguments != "{}"):
        raise BadInput("--arguments and --control-hz: expected --vla-eval beside them, got none")
    module = None if benchmark is None else _listed(name, benchmark, arguments, control_hz)
    written = (ADAPTER if module is None else BENCHMARK).write(name, folder)
    if module is not None:
        written.append(folder / f"robogauntlet_{name.replace('-', '_')}.py")
        written[-1].write_text(module, encoding="utf-8")
    for path in written:
        print_line(str(path))
    print_line(f"\ncd {folder}")
    print_line("pip install --no-deps -e .")
    print_line(f"robogauntlet check adapter {name}")


def _listed(name: str, benchmark: str, arguments: str, control_hz: float | None) -> str:
    """Return the module of a benchmark. Raises BadInput for arguments that are none, and AdapterError."""
    if control_hz is None:
        raise BadInput("--control-hz: expected the control steps per simulated second, which no class says, got none")
    try:
        given: Any = parse_json(arguments)
    except ValueError:
        given = None
    if not isinstance(given, dict):
        raise BadInput(f"--arguments: expected a JSON object, such as '{{\"seed\": 7}}', got '{arguments[:80]}'")
    if catalog.find_spec("vla_eval") is None:
        raise BadInput("--vla-eval: not installed (no module vla_eval); install it: pip install vla-eval")
    from robogauntlet.adapters.vla_eval.listing import listing

    return listing(name, benchmark, given, control_hz, print_line)
