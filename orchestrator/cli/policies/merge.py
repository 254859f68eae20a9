"""`gauntlet policies merge`: merge experts into one model that infers its task."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.table import Table

from orchestrator.cli.policies.training import needs_training_packages
from orchestrator.cli.shared import BadInput, out
from orchestrator.folders import explain_at
from policies.contract import PolicyError
from policies.mergevla.card import CARD, WEIGHTS, CheckpointError, card_json
from policies.mergevla.merged_card import KIND
from policies.mergevla.merged_policy import expert_folders
from policies.mergevla.merging.errors import ExpertsDiffer, MergeError, OutOfRange
from policies.mergevla.merging.recipe import LAMBDA, MASKS_OF, BackboneRule, MaskRule, Recipe, TrunkRule
from policies.zoo import shipped
from suites.plugins import nearest

AUTO = "auto"
Rule = TypeVar("Rule", MaskRule, TrunkRule)

if TYPE_CHECKING:
    from torch import Tensor

    from policies.mergevla.merged_model import Parts
    from policies.mergevla.merging.diagnostics import MergeReport
    from policies.mergevla.merging_experts import Experts
    from policies.training.dataset import Demonstrations


def merge(
    experts: Annotated[list[str], typer.Argument(metavar="EXPERTS...", help="Checkpoints, or folders of them.")],
    out_folder: Annotated[Path, typer.Option("--out", help="Folder of the merged checkpoint.")],
    operator: Annotated[
        str, typer.Option(help="mean, ta, ties, dare, tsv, knots, wudi, emr, magnitude or flat.")
    ] = "ties",
    masks: Annotated[
        str | None, typer.Option(help="none, task, emr or signs; by default the operator's own, else task.")
    ] = None,
    lambdas: Annotated[
        list[str] | None,
        typer.Option(
            "--lambda",
            metavar="NUMBER|TASK=NUMBER|auto",
            help="Of the task masks. Repeatable. auto: for each task the best on its held-out demonstrations.",
        ),
    ] = None,
    rounds: Annotated[
        int, typer.Option(help="Bits spent on each weight under masks signs: each round reads what is left over.")
    ] = 1,
    alpha: Annotated[float, typer.Option(help="Scale of the merged task vector.")] = 1.0,
    trunk: Annotated[
        str, typer.Option(help="vectors: merged as the backbone is; mean: averaged, as in the paper.")
    ] = "vectors",
    keep_blocks: Annotated[int, typer.Option(help="k, the last blocks that each task keeps.")] = 1,
    merge_output: Annotated[bool, typer.Option(help="Merge the output layer with the trunk.")] = False,
    select: Annotated[bool, typer.Option(help="Keep each task's own adapter instead of merging backbones.")] = False,
    options: Annotated[
        list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="Of the operator. Repeatable.")
    ] = None,
    demonstrations: Annotated[
        list[Path] | None,
        typer.Option(help="Datasets, or folders of them, to fit routers on. Repeatable. Without, some cannot be used."),
    ] = None,
) -> None:
    """Merge experts of one base, which must stay where it is, and say what merging did to them."""
    with needs_training_packages():
        import sklearn  # noqa: F401  needed by what imports it late

        from policies.mergevla.merged_checkpoint import save_merged
        from policies.mergevla.merging_experts import merge_experts, read_experts
        from policies.training.dataset import datasets_of
    try:
        _check_out(out_folder)
        read = read_experts(_checkpoints(experts))
        recipe = Recipe(
            operator=operator,
            alpha=alpha,
            masks=_rule(MaskRule, masks or MASKS_OF.get(operator, MaskRule.TASK)),
            lambda_=LAMBDA if lambdas == [AUTO] else _lambdas(lambdas or (), tuple(read.by_task)),
            rounds=rounds,
            trunk=_rule(TrunkRule, trunk),
            kept_blocks=keep_blocks,
            merge_output=merge_output,
            backbone=BackboneRule.SELECT if select else BackboneRule.MERGED,
            options=_options(options or ()),
        )
        shown = datasets_of(demonstrations or (), tuple(read.by_task))
        instructions = {dataset.task: dataset.instructions[0] for dataset in shown}
        if lambdas == [AUTO]:
            recipe = _chosen(read, recipe, shown, instructions)
        merging = merge_experts(read, recipe, instructions)
        card = save_merged(out_folder, merging, _fit(merging.parts, shown) if shown else None)
    except PolicyError as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(explain_at(error, out_folder)) from None
    _show(merging.report, recipe, _losses(read, merging.parts, shown, instructions) if shown else {})
    size = (out_folder / WEIGHTS).stat().st_size / 1e6
    routers = f"fitted routers: {', '.join(card.routers)}" if card.routers else "no router was fitted"
    said = f"{out_folder}: {len(card.experts)} experts merged, {size:.1f} MB beside the base; {routers}"
    out.print(said, markup=False, soft_wrap=True)


def _checkpoints(references: Sequence[str]) -> list[str]:
    """The experts' checkpoints, those in folders of them included."""
    found: list[str] = []
    for reference in references:
        folder = shipped(reference)
        if folder.is_dir() and not (folder / CARD).exists() and not (folder / WEIGHTS).exists():
            found += map(str, expert_folders(folder).values())
        else:
            found.append(reference)
    return found


def _check_out(folder: Path) -> None:
    """Refuse to write over anything but an earlier merged checkpoint, or what a killed merge left."""
    if folder.is_dir() and all(_is_leftover(path) for path in folder.iterdir()):
        return
    if folder.exists() and not ((folder / CARD).is_file() and card_json(folder).get("kind") == KIND):
        raise CheckpointError(f"expected a new folder or that of a merged checkpoint for --out, got '{folder}'")


def _is_leftover(path: Path) -> bool:
    """Whether this is half a file of ours, or of safetensors."""
    return path.is_file() and (path.suffix == ".partial" or path.name.startswith(".tmp"))


def _rule(rules: type[Rule], value: str) -> Rule:
    if value not in tuple(rules):
        raise OutOfRange(f"expected one of {', '.join(rules)}, got '{value}'")
    return rules(value)


def _lambdas(given: Sequence[str], experts: tuple[str, ...]) -> float | dict[str, float]:
    """One number for all, or one for each expert if any was named."""
    for_all, named = LAMBDA, {}
    for text in given:
        task, _, number = text.rpartition("=")
        if task and task not in experts:
            raise ExpertsDiffer(f"expected --lambda for one of the experts, got '{task}'{nearest(task, experts)}")
        try:
            value = float(number)
        except ValueError:
            raise OutOfRange(f"expected --lambda NUMBER or TASK=NUMBER, got '{text}'") from None
        if task:
            named[task] = value
        else:
            for_all = value
    return {expert: named.get(expert, for_all) for expert in experts} if named else for_all


def _options(given: Sequence[str]) -> dict[str, Any]:
    """Names to numbers, or to text where that is no number."""
    found: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not name or not equals:
            raise MergeError(f"expected --option NAME=VALUE, got '{text}'")
        try:
            found[name] = json.loads(value)
        except ValueError:
            found[name] = value
    return found


def _fit(parts: Parts, datasets: Sequence[Demonstrations]) -> dict[str, Tensor]:
    from policies.mergevla.merged_model import MergedModel
    from policies.mergevla.routing.catalog import fit_routers
    from policies.mergevla.routing.demonstrations import first_sightings

    first = first_sightings(datasets, parts.architecture.cameras)
    return fit_routers(MergedModel(parts), first.frames, first.held_out)


def _chosen(
    experts: Experts, recipe: Recipe, datasets: Sequence[Demonstrations], instructions: dict[str, str]
) -> Recipe:
    """The recipe with the lambda that is best for each task."""
    from policies.training.pool import Pool
    from policies.training.selection import choose_lambdas

    if not datasets:
        raise MergeError(f"expected --demonstrations with --lambda {AUTO}, got none")
    chosen, _ = choose_lambdas(experts, recipe, Pool(datasets), instructions, progress=out.print)
    assert not isinstance(chosen.lambda_, float)
    for task, value in chosen.lambda_.items():
        out.print(f"{task}: lambda {value:g}", markup=False, highlight=False)
    return chosen


def _losses(
    experts: Experts, parts: Parts, datasets: Sequence[Demonstrations], instructions: dict[str, str]
) -> dict[str, tuple[float, float]]:
    """Task to the L1 on its held-out demonstrations, of the expert and merged; empty where nothing is held out."""
    from policies.mergevla.merged_model import MergedModel
    from policies.training.pool import Pool
    from policies.training.selection import experts_l1, held_out_l1

    if any(dataset.episodes < 2 for dataset in datasets):
        return {}
    pool = Pool(datasets)
    alone = experts_l1(experts, pool, instructions)
    merged = held_out_l1(MergedModel(parts).model, parts.statistics, pool)
    return {task: (alone[task], merged[task]) for task in alone}


def _show(report: MergeReport, recipe: Recipe, losses: Mapping[str, tuple[float, float]]) -> None:
    """What the masks keep of the merged vector, beside what they would keep of unrelated ones."""
    table = Table("expert", box=None, pad_edge=False)
    for title in (
        "keep rate",
        "chance",
        "cosine",
        "chance",
        "mask KB",
        "own KB",
        "as LoRA KB",
        "held-out L1",
        "merged",
    ):
        table.add_column(title, justify="right")
    observed, chance = report.observed, report.null
    for expert in report.experts:
        size = report.bytes_per_task[expert]
        rates = (observed.keep[expert], chance.keep[expert], observed.cosine[expert], chance.cosine[expert])
        sizes = (size.mask, size.head, size.lora)
        table.add_row(
            expert,
            *(f"{rate:.3f}" for rate in rates),
            *("-" if count is None else f"{count / 1e3:.1f}" for count in sizes),
            *(f"{loss:.3f}" for loss in losses.get(expert, ())),
        )
    out.print(table)
    out.print(f"selfish rate {observed.selfish:.3f}, by chance {chance.selfish:.3f}; {report.entries} weights merged")
    for part, distances in report.block_distances.items():
        first_kept = len(distances) - recipe.kept_blocks
        trunk, head = (" ".join(f"{d:.3f}" for d in some) for some in (distances[:first_kept], distances[first_kept:]))
        said = f"distance of experts by block, {part}: merged {trunk or 'none'}; kept {head or 'none'}"
        out.print(said, soft_wrap=True)
