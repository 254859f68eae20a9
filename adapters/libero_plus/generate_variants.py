"""Writes `variants.json`: `python -m robogauntlet.adapters.libero_plus.generate_variants`, where both are installed.

The file has all that the catalog needs without LIBERO-Plus: by axis and task of LIBERO, the codes of the variants, and
of those whose rewritten instruction is none. A test compares it with the package.
"""

from __future__ import annotations

import ast
import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

from robogauntlet.adapters.libero.tasks import libero_tasks
from robogauntlet.adapters.libero_plus.task_files import plus_folder, rewritten_instruction
from robogauntlet.adapters.libero_plus.variants import REJECTED, PlusAxis, short_name

SUFFIXES = {
    r"_language_(\d+)_view_0_0_100_0_0_initstate_0": PlusAxis.LANGUAGE,
    r"_view_0_0_100_0_0_initstate_0_noise_(\d+)": PlusAxis.NOISE,
    r"_view_(\d+_\d+_\d+_\d+_\d+)_initstate_0": PlusAxis.CAMERA,
    r"_view_0_0_100_0_0_initstate_(\d+)": PlusAxis.ROBOT,
    r"_light_(\d+)": PlusAxis.LIGHT,
    r"_((?:table|tb)_\d+)": PlusAxis.BACKGROUND,
    r"_(add_\d+|moved_level\d+_sample\d+|level\d+_sample\d+)": PlusAxis.LAYOUT,
}
"""How LIBERO-Plus's names end, to the axis."""
_OTHERS = "variation|paraphrase|rephrasing|rewording|rewrite|alternative|version|example"
ABOUT_INSTRUCTIONS = re.compile(
    rf"\b({_OTHERS})s?\b.*\b(instruction|sentence)s?\b|\b(instruction|sentence)s?\b.*\b(rephrased|rewritten|reworded)\b"
    r"|\blanguage model\b|^(certainly|sorry)\b"
)
"""What an answer says about the sentences that were asked for, and no instruction says."""

Index = Mapping[str, Mapping[str, list[int | str]]]


def task_map(folder: Path) -> Mapping[str, list[str]]:
    """Return LIBERO-Plus's list of tasks by suite, from the text of its module."""
    text = (folder / "benchmark" / "libero_suite_task_map.py").read_text(encoding="utf-8")
    (value,) = [node.value for node in ast.parse(text).body if isinstance(node, ast.Assign)]
    listed: Mapping[str, list[str]] = ast.literal_eval(value)
    return listed


def perturbed_names(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield suite and name of every task that is not LIBERO's own."""
    for suite, names in task_map(folder).items():
        if suite != "libero_90":
            yield from ((suite, name) for name in names)


def survey(folder: Path) -> Index:
    """Return the codes of all variants by axis and task of LIBERO.

    Raises:
        ValueError: A name does not end as expected.
    """
    bases = {(base.libero_suite, base.name): short_name(base) for base in libero_tasks().values()}
    found: dict[str, dict[str, list[int | str]]] = {axis: defaultdict(list) for axis in PlusAxis}
    for suite, name in perturbed_names(folder):
        for suffix, axis in SUFFIXES.items():
            ending = re.search(f"{suffix}$", name)
            if ending and (base := bases.get((suite, name[: ending.start()]))):
                code = re.sub(r"level|sample", "", ending[1]).replace("_", "-")
                kind = "level-" if ending[1].startswith("level") else ""
                found[axis][base].append(int(code) if code.isdecimal() else kind + code)
                break
        else:
            raise ValueError(f"{suite}: expected a name of LIBERO's with a known ending, found '{name}'")
    named = {short: base for base, short in bases.items()}
    for short, codes in found[PlusAxis.LANGUAGE].items():
        suite, name = named[short]
        sentences = {code: rewritten_instruction(suite, f"{name}_{PlusAxis.LANGUAGE}_{code}") for code in codes}
        if none := [code for code, sentence in sentences.items() if ABOUT_INSTRUCTIONS.search(sentence or "")]:
            found.setdefault(REJECTED, {})[short] = none
    order = list(dict.fromkeys(bases.values()))
    return {axis: {base: of_axis[base] for base in order if base in of_axis} for axis, of_axis in found.items()}


def written(index: Index) -> str:
    """Format the file, with one task of LIBERO on each line."""
    parts = (
        f'"{axis}": {{\n'
        + ",\n".join(f'"{base}": {json.dumps(codes, separators=(",", ":"))}' for base, codes in tasks.items())
        + "\n}"
        for axis, tasks in index.items()
    )
    return "{\n" + ",\n".join(parts) + "\n}\n"


if __name__ == "__main__":
    installed = plus_folder()
    if installed is None:
        raise SystemExit("LIBERO-Plus is not installed here: robogauntlet env create libero-plus")
    Path(__file__).with_name("variants.json").write_text(written(survey(installed)), encoding="utf-8")
