"""`robogauntlet mergevla merge`: merge experts into one model that infers the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from robogauntlet.orchestrator.cli.common import out, print_line
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput, describe_os_error_at
from robogauntlet.support.json_text import parse_json
from robogauntlet_mergevla.checkpoints.merged_metadata import KIND
from robogauntlet_mergevla.checkpoints.metadata import (
    METADATA_FILE,
    WEIGHTS,
    CheckpointError,
    read_metadata_file,
)
from robogauntlet_mergevla.cli.training_progress import needs_training_packages
from robogauntlet_mergevla.merging.errors import ExpertsDiffer, MergeError, OutOfRange
from robogauntlet_mergevla.merging.recipe import LAMBDA, MASKS_OF, UNMERGED, BackboneRule, MaskRule, Recipe
from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.zoo import shipped

AUTO = "auto"

if TYPE_CHECKING:
    from torch import Tensor

    from robogauntlet.policies.training.dataset import Demonstrations
    from robogauntlet_mergevla.checkpoints.merge_experts import Experts, Merging
    from robogauntlet_mergevla.checkpoints.merged_model import MergedWeights


def merge(
    experts: Annotated[list[str], typer.Argument(metavar="EXPERTS...", help="Expert checkpoints, or folders of them.")],
    out_folder: Annotated[Path, typer.Option("--out", help="Folder of the merged checkpoint.")],
    operator: Annotated[
        str,
        typer.Option(
            help="Merging operator: mean, ta, ties, ties-published, dare, "
            "emr, magnitude or flat; or none: each task keeps its expert, quantised to --bits."
        ),
    ] = "ties",
    masks: Annotated[
        str | None, typer.Option(help="Masks: none, task, emr or signs; by default those of the operator, else task.")
    ] = None,
    lambdas: Annotated[
        list[str] | None,
        typer.Option(
            "--lambda",
            metavar="NUMBER|EXPERT=NUMBER|auto",
            help="Lambda of the task masks. Repeatable. auto: the best on held-out demonstrations of each expert.",
        ),
    ] = None,
    rounds: Annotated[
        int,
        typer.Option(help="Bits per weight with --masks signs; each round encodes the remainder of the one before."),
    ] = 1,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PART",
            help="Part to merge: vision, projector, language, language.0-3 (blocks) or trunk; tasks keep their own of "
            "all others. Repeatable; by default all parts are merged.",
        ),
    ] = None,
    bits: Annotated[
        int | None,
        typer.Option(
            help="Bits per weight, from 2 to 8, of all that is stored beside the base, masks left out; needed with "
            "--operator none.",
            show_default=False,
        ),
    ] = None,
    alpha: Annotated[float, typer.Option(help="Scale of the merged task vector.")] = 1.0,
    trunk: Annotated[
        str,
        typer.Option(
            help="Trunk of the action expert: vectors (merged like the backbone) or mean (averaged, as in the paper)."
        ),
    ] = "vectors",
    keep_blocks: Annotated[int, typer.Option(help="Number of last blocks that stay separate for each task (k).")] = 1,
    merge_output: Annotated[bool, typer.Option(help="Merge the output layer with the trunk.")] = False,
    select: Annotated[bool, typer.Option(help="Keep each task's own adapter instead of merging backbones.")] = False,
    options: Annotated[
        list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="Option of the operator. Repeatable.")
    ] = None,
    demonstrations: Annotated[
        list[Path] | None,
        typer.Option(help="Datasets, or folders of them, to fit routers on; some routers need them. Repeatable."),
    ] = None,
    routers: Annotated[
        list[str] | None,
        typer.Option(
            "--router",
            metavar="NAME",
            help="Router to fit: calibrated, nearest-centroid or self-trained. Repeatable; by default all.",
        ),
    ] = None,
    weights: Annotated[
        bool,
        typer.Option(help="Store the merged weights; without, the experts are merged whenever the model is loaded."),
    ] = True,
) -> None:
    """Merge experts of one base into one model that infers the task.

    The base must stay where it is, and with --no-weights the experts.
    """
    with needs_training_packages():
        import sklearn  # noqa: F401  imported late by the routers

        from robogauntlet.policies.training.dataset import datasets_of
        from robogauntlet_mergevla.checkpoints.merge_experts import merge_experts, read_experts
        from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged
    try:
        _check_out(out_folder)
        _check_routers(routers or (), demonstrations or ())
        read = read_experts(_checkpoints(experts))
        recipe = Recipe.from_json(
            {
                "operator": operator,
                "alpha": alpha,
                "masks": masks or MASKS_OF.get(operator, MaskRule.TASK),
                "lambda_": LAMBDA if lambdas == [AUTO] else _lambdas(lambdas or (), tuple(read.by_name)),
                "rounds": rounds,
                "trunk": trunk,
                "kept_blocks": keep_blocks,
                "merge_output": merge_output,
                "backbone": BackboneRule.SELECT if select else BackboneRule.MERGED,
                "only": tuple(only or ()),
                "options": _options(options or ())
                | ({"bits": bits} if bits is not None and operator == UNMERGED else {}),
                "bits": None if operator == UNMERGED else bits,
            }
        )
        datasets = datasets_of(demonstrations or (), tuple(chain.from_iterable(read.tasks.values())))
        instructions = {dataset.task: dataset.instructions[0] for dataset in datasets}
        if lambdas == [AUTO]:
            recipe = _best_lambdas(read, recipe, datasets, instructions)
        merging = merge_experts(read, recipe, instructions)
        fitted = _fit(merging.parts, datasets, routers or ()) if datasets else None
        metadata = save_merged(out_folder, merging, fitted, weights=weights)
    except OSError as error:
        raise BadInput(describe_os_error_at(error, out_folder)) from None
    _show(merging, _losses(read, merging.parts, datasets, instructions, lambdas) if datasets else {})
    size = (out_folder / WEIGHTS).stat().st_size / 1e6
    beside = "the base" if weights else "base and experts"
    fits = f"fitted routers: {', '.join(metadata.routers)}" if metadata.routers else "no router was fitted"
    print_line(f"{out_folder}: {len(metadata.experts)} experts merged, {size:.1f} MB beside {beside}; {fits}")


def _checkpoints(references: Sequence[str]) -> list[str]:
    """The expert checkpoints, including those in folders."""
    checkpoints: list[str] = []
    for reference in references:
        folder = shipped(reference)
        if folder.is_dir() and not (folder / METADATA_FILE).exists() and not (folder / WEIGHTS).exists():
            checkpoints += map(str, dict.fromkeys(expert_folders(folder).values()))
        else:
            checkpoints.append(reference)
    return checkpoints


def _check_out(folder: Path) -> None:
    """Refuse to overwrite anything but a merged checkpoint or the remains of a killed merge."""
    if folder.is_dir() and all(_is_leftover(path) for path in folder.iterdir()):
        return
    if folder.exists() and not ((folder / METADATA_FILE).is_file() and read_metadata_file(folder).get("kind") == KIND):
        raise CheckpointError(f"expected a new folder or that of a merged checkpoint for --out, got '{folder}'")


def _check_routers(names: Sequence[str], demonstrations: Sequence[Path]) -> None:
    """Refuse what cannot be fitted before anything is merged."""
    from robogauntlet_mergevla.routing.catalog import FITTED

    if names and not demonstrations:
        raise MergeError("expected --demonstrations with --router, got none")
    for name in names:
        if name not in FITTED:
            raise MergeError(f"expected --router {' or '.join(FITTED)}, got '{name}'{did_you_mean(name, FITTED)}")


def _is_leftover(path: Path) -> bool:
    """Whether this is a partial file of ours or of safetensors."""
    return path.is_file() and (path.suffix == ".partial" or path.name.startswith(".tmp"))


def _lambdas(given: Sequence[str], experts: tuple[str, ...]) -> float | dict[str, float]:
    """One number for all experts, or one for each expert if any is named."""
    for_all, named = LAMBDA, {}
    for text in given:
        expert, _, number = text.rpartition("=")
        if expert and expert not in experts:
            raise ExpertsDiffer(
                f"expected --lambda for one of the experts, got '{expert}'{did_you_mean(expert, experts)}"
            )
        try:
            value = float(number)
        except ValueError:
            raise OutOfRange(f"expected --lambda NUMBER or EXPERT=NUMBER, got '{text}'") from None
        if expert:
            named[expert] = value
        else:
            for_all = value
    return {expert: named.get(expert, for_all) for expert in experts} if named else for_all


def _options(given: Sequence[str]) -> dict[str, Any]:
    """Option names to their values, as JSON or else as text."""
    options: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not name or not equals:
            raise MergeError(f"expected --option NAME=VALUE, got '{text}'")
        options[name] = value
        with suppress(ValueError):
            options[name] = parse_json(value)
    return options


def _fit(parts: MergedWeights, datasets: Sequence[Demonstrations], names: Sequence[str]) -> dict[str, Tensor]:
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing.catalog import fit_routers
    from robogauntlet_mergevla.routing.demonstrations import first_observations

    first = first_observations(datasets, parts.architecture.cameras)
    return fit_routers(MergedModel(parts), first.frames, first.held_out, names)


def _best_lambdas(
    experts: Experts, recipe: Recipe, datasets: Sequence[Demonstrations], instructions: dict[str, str]
) -> Recipe:
    """The recipe with the best lambda for each expert."""
    from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
    from robogauntlet_mergevla.training.lambda_selection import choose_lambdas

    if not datasets:
        raise MergeError(f"expected --demonstrations with --lambda {AUTO}, got none")
    chosen, _ = choose_lambdas(experts, recipe, DatasetMixture(datasets), instructions, progress=out.print)
    assert isinstance(chosen.lambda_, Mapping)
    for name, value in chosen.lambda_.items():
        out.print(f"{name}: lambda {value:g}", markup=False, highlight=False)
    return chosen


def _losses(
    experts: Experts,
    parts: MergedWeights,
    datasets: Sequence[Demonstrations],
    instructions: dict[str, str],
    lambdas: list[str] | None,
) -> dict[str, tuple[float, float]]:
    """Expert to its held-out L1 and that of the merged model, means over its tasks.

    Empty if a task has too few held-out episodes. If lambda was chosen on half of them, it is the loss on the others.
    """
    import numpy as np

    from robogauntlet_mergevla.training.dataset_mixture import HELD_OUT_EVERY, DatasetMixture, HeldOut
    from robogauntlet_mergevla.training.lambda_selection import experts_l1, merged_l1

    part, needed = (HeldOut.SCORE, 2 * HELD_OUT_EVERY) if lambdas == [AUTO] else (HeldOut.ALL, 2)
    if any(dataset.episodes < needed for dataset in datasets):
        return {}
    pool = DatasetMixture(datasets)
    alone = experts_l1(experts, pool, instructions, part=part)
    merged = merged_l1(parts, pool, part=part)
    return {
        name: (float(np.mean([alone[task] for task in tasks])), float(np.mean([merged[task] for task in tasks])))
        for name, tasks in experts.tasks.items()
    }


def _show(merging: Merging, losses: Mapping[str, tuple[float, float]]) -> None:
    """Print what each task takes, and what masks keep of the merged task vector beside what they would by chance."""
    report, recipe = merging.report, merging.parts.recipe
    observed, chance = report.observed, report.null
    table = Table("expert", box=None, pad_edge=False)
    rates = ("keep rate", "chance", "cosine", "chance", "mask KB") if report.entries else ()
    for title in (*rates, "own KB", "as LoRA KB", "held-out L1", "merged"):
        table.add_column(title, justify="right")
    for expert in report.experts:
        size = report.bytes_per_task[expert]
        kept = (observed.keep[expert], chance.keep[expert], observed.cosine[expert], chance.cosine[expert])
        sizes = (size.mask, size.head, size.lora) if report.entries else (size.head, size.lora)
        table.add_row(
            expert,
            *(f"{rate:.3f}" for rate in kept if report.entries),
            *("-" if count is None else f"{count / 1e3:.1f}" for count in sizes),
            *(f"{loss:.3f}" for loss in losses.get(expert, ())),
        )
    out.print(table)
    if report.entries:
        out.print(
            f"selfish rate {observed.selfish:.3f}, by chance {chance.selfish:.3f} (entries in a random order within "
            f"each weight; Gaussian entries: {report.gaussian.selfish:.3f}); {report.entries} weights merged"
        )
    for part, distances in report.block_distances.items():
        texts, first_kept = [f"{distance:.3f}" for distance in distances], len(distances) - recipe.kept_blocks
        trunk, head = " ".join(texts[:first_kept]), " ".join(texts[first_kept:])
        print_line(f"distance of experts by block, {part}: merged {trunk or 'none'}; kept {head or 'none'}")
