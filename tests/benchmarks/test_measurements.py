"""Every measurement that a page names can be made, and its rows are committed."""

import importlib
import json
import re
import time

import pandas as pd
import pytest

from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.ray_runtime.session import ray_session
from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from tests import ROOT
from tests.benchmarks import environments, operators, routers, training_controls, unknown_scenes
from tests.benchmarks.document import MEASUREMENTS, PAGES
from tests.benchmarks.shared import EXPERT_VIEW

NAMED = re.compile(r"python -m\s+tests\.benchmarks\s+(\w+)")
FILES = sorted(MEASUREMENTS.glob("*.json"))
PERFORMANCE = (ROOT / "docs/performance.md").read_text(encoding="utf-8")


def rows(name):
    return json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))["rows"]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_the_rows_of_every_benchmark_that_a_page_names_are_committed(page):
    named = set(NAMED.findall(page.read_text(encoding="utf-8")))
    assert named <= {path.stem for path in FILES}


def test_every_committed_measurement_has_a_benchmark():
    measured = [json.loads(path.read_text(encoding="utf-8")) | {"name": path.stem} for path in FILES]
    names = [one["name"] for one in measured if "command" not in one]
    assert all(callable(importlib.import_module(f"tests.benchmarks.{name}").measure) for name in names)


def test_the_ratios_to_the_harness_are_those_of_the_rows():
    own = [row for row in rows("vla_eval") if "own" in row["frames"]]
    untrained, experts = (
        [row["ratio"] for row in own if row["policy"] == policy] for policy in ("untrained", "mergevla-experts")
    )
    assert f"({min(untrained):.1f} to {max(untrained):.1f})" in PERFORMANCE
    assert f"({min(experts):.1f} to {max(experts):.1f})" in PERFORMANCE.replace("\n", " ")


def test_the_estimates_of_larger_clusters_are_from_the_rows():
    page = (ROOT / "docs/scaling.md").read_text(encoding="utf-8")
    largest = rows("scale")[-1]
    for workers in (160, 1_600):
        assert f"{100 * largest['computing'] * workers / largest['workers']:.0f} % of a core" in page
    assert f"it handles {round(largest['per_second'], -2):,.0f} |" in page


@pytest.mark.ray
def test_the_first_reset_of_a_worker_is_found_behind_the_loading_of_its_policy():
    with ray_session(address=None, workers=1):
        began = time.time()
        seconds = environments._first_reset("null/Reach", EnvironmentResolver({}))
        assert 0.0 < seconds < time.time() - began


def test_the_comparison_in_the_readme_is_that_of_the_demo_s_episodes():
    """The demo plays the first ten seeds of the suite `mergevla`."""
    rows = pd.read_parquet(MEASUREMENTS / "mergevla.parquet").query("seed < 10")
    won = rows.assign(won=rows.status == "success").pivot(index=["task", "seed"], columns="policy", values="won")
    shown = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    for name, pattern in (("pybullet/PandaPickAndPlace-v3",) * 2, ("all of pybullet", "pybullet/"), ("all tasks", "")):
        pairs = won[won.index.get_level_values("task").str.startswith(pattern)]
        blind, told = (pairs[policy].to_numpy(float) for policy in ("merged-instruction-hidden", "merged"))
        found = paired_difference(Pairs.from_outcomes(blind, told))
        low, high = found.interval.low, found.interval.high
        difference = f"{100 * found.value:.1f} [{100 * low:.1f}, {100 * high:.1f}]"
        (line,) = (line for line in shown if line.startswith(name + "  "))
        assert re.sub(" +", " ", line.removeprefix(name)).startswith(
            f" {len(pairs)} {100 * blind.mean():.0f} % {100 * told.mean():.0f} % {difference}"
        )


def test_what_the_page_says_of_blocks_is_in_the_rows():
    rows = json.loads((MEASUREMENTS / "training_controls.json").read_text(encoding="utf-8"))["rows"]
    page, by_kind = (ROOT / "docs/mergevla.md").read_text(encoding="utf-8"), {row["kind"]: row for row in rows}
    others = [by_kind[kind] for kind in ("cross-tanh", "self-sigmoid", "self-tanh")]
    unaveraged = [row[way].partition(": ")[2] for row in others for way in ("experts", "signs", "ta-s")]
    assert max(abs(int(text.split(" [")[0])) for text in unaveraged) == 6
    widest = max(unaveraged, key=lambda text: int(text.split(", ")[1].rstrip("]")))
    frame = pd.read_parquet(MEASUREMENTS / "training_controls.parquet")
    tanh_first = frame[~frame.policy.str.match(r"cross-sigmoid-(experts|signs|ta-s|paper)-")]
    tanh_first = tanh_first.assign(policy=tanh_first.policy.str.replace("cross-tanh", training_controls.REFERENCE))
    both = next(row for row in training_controls.rows_of(tanh_first) if row["kind"] == "self-tanh")
    assert both["paper"].endswith(": -17 [-25, -10]")
    assert f"with intervals as wide as [{widest.split('[')[1]}." in page
    averaged = {kind: row["paper"] for kind, row in by_kind.items()}
    tanh, attention, adapter = (row["paper"].partition(": ")[2] for row in others)
    assert averaged["self-tanh"].startswith("45 (38 / 44 / 52)")
    assert averaged["cross-sigmoid"] == "62 (68 / 62 / 55)"
    assert f"by {tanh}, self-attention alone by {attention}" in page
    assert f"but {adapter} shows no difference" in page
    assert [by_kind["self-tanh-fresh"]["mean"][way] for way in ("ta-s", "paper")] == [0, 6]
    assert [by_kind["cross-sigmoid-fresh"][way].split(" (")[1][0] for way in ("ta-s", "paper")] == ["7", "8"]
    each = [[int(rate) for rate in averaged[row["kind"]].split("(")[1].split(")")[0].split(" / ")] for row in others]
    assert [max(rates) - min(rates) for rates in [*each, [68, 62, 55]]] == [12, 30, 14, 13]
    assert by_kind["self-sigmoid"]["experts"].startswith("87 (93 / 78 / 91)")


def both_sets(name):
    """Rows of a table of merges by policy, of the zoo's experts and of those from fewer demonstrations; the latter's
    episodes.
    """
    now, played = rows(name), pd.read_parquet(MEASUREMENTS / f"{name}_fewer.parquet")
    before = operators.rows_of(played, {row["policy"]: row["kilobytes"] for row in now})
    return *({row["policy"]: row for row in one} for one in (now, before)), played


def kept(of, *policies):
    """The shares of the experts' success that these keep (percent)."""
    return [of[policy]["kept"].partition(" %")[0] for policy in policies]


def test_what_the_page_says_of_operators_is_in_the_rows_of_both_sets_of_experts():
    now, before, played = both_sets("operators")

    def rate(of, *policies):
        return [int(of[policy]["success"].partition(" %")[0]) for policy in policies]

    merged = ["ties-published-s", "wudi-s", "tsv-s", "knots-ties-s", "ta-s", "ties-s", "emr"]
    ours, theirs = kept(now, *merged), kept(before, *merged)
    assert theirs[1] == theirs[5]
    cube = "maniskill/StackCube-v1"
    stacked = [
        f"{(episodes[(episodes.policy == policy) & (episodes.task == cube)].status == 'success').mean():.0%}"[:-1]
        for policy in ("ta-s", "ties-published-s")
        for episodes in (played, pd.read_parquet(MEASUREMENTS / "operators.parquet"))
    ]
    masked = rate(now, *merged[:-1])
    averaged = rate(now, "ta-s-averaged-trunk", "ties-s-averaged-trunk")
    both = [*kept(now, "signs-2", "none-4"), *kept(before, "signs-2", "none-4")]
    assert min(map(int, both)) > max(map(int, [*ours, *theirs]))
    page = " ".join((ROOT / "docs/mergevla.md").read_text(encoding="utf-8").split())
    for said in (
        f"four bits per weight keep {now['none-4']['kept']} of the experts' success with 530 kB",
        f"the shipped merge keeps {kept(now, 'signs-2')[0]} % with 1,477 kB",
        f"succeed in {min(masked)} to {max(masked)} % if the trunk is merged by task vectors, in {min(averaged)} to "
        f"{max(averaged)} % if",
        f"Three bits keep {now['none-3']['kept']} with 403 ({kept(before, 'none-3')[0]} % with other experts",
        f"the mean of all tasks falls to {rate(now, 'none-2')[0]} %. `signs-2`, the shipped model, keeps "
        f"{now['signs-2']['kept']} too",
        f"(with masks, {now['ties-published-s']['kept']}); WUDI has {ours[1]}, TSV {ours[2]}, KnOTS {ours[3]}, TA "
        f"{ours[4]}, TIES of MergeVLA's code {ours[5]}, EMR {ours[6]}.",
        f"TA+S kept {before['ta-s']['kept']}, TSV {theirs[2]}, WUDI and TIES {theirs[1]}, TIES as published "
        f"{theirs[0]}, KnOTS {theirs[3]}, EMR {theirs[6]}; of StackCube, TA+S had {stacked[0]} % instead of "
        f"{stacked[1]}, TIES as published {stacked[2]} instead of {stacked[3]} (",
        f"TA+S falls from {rate(now, 'ta-s')[0]} to {averaged[0]} %",
        f"(`flat`) they keep {kept(now, 'flat-2')[0]} % too. One bit keeps {now['flat-1']['kept']} instead of "
        f"{now['signs-1']['kept']}",
    ):
        assert said in page
    assert kept(now, "flat-2") == kept(now, "signs-2")
    assert (max(ours, key=int), max(theirs, key=int)) == (ours[0], theirs[4])  # TIES as published now, TA+S before
    won = pd.read_parquet(MEASUREMENTS / "operators.parquet").assign(won=lambda played: played.status == "success")
    wide = won.pivot(index=["task", "seed"], columns="policy", values="won")
    lost = (wide["experts"] & ~wide["none-4"]).groupby("task").sum()
    assert not (wide["none-4"] & ~wide["experts"]).any()
    assert f"of {len(wide)} episodes it loses {lost.sum()}, of them {lost['robosuite/Stack']} in Stack" in page
    trunks = (100 * wide[["ta-s", "ta-s-averaged-trunk"]].groupby("task").mean()).round().astype(int)
    pull, cubes, door, stack = (
        trunks.loc[task].tolist() for task in ("maniskill/PullCube-v1", cube, "robosuite/Door", "robosuite/Stack")
    )
    assert f"PullCube from {pull[0]} to {pull[1]}, Door from {door[0]} to {door[1]}, Stack from {stack[0]} to" in page
    assert f"to {stack[1]}; StackCube is lost with either trunk ({cubes[0]} and {cubes[1]} %)" in page
    alone = f"{rate(now, 'joint')[0]} %. TA+S ({rate(now, 'ta-s')[0]} %) and TIES+S ({rate(now, 'ties-s')[0]} %)"
    assert f"succeeds in {alone} are not shown" in page
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert (
        f"Four bits per weight keep {kept(now, 'none-4')[0]} % of the experts' success with 530 kB per task" in readme
    )
    assert [now[name]["kilobytes"] for name in ("none-4", "none-3", "signs-2")] == pytest.approx(
        [530, 403, 1477], abs=0.5
    )


def test_what_the_page_says_of_parts_blocks_and_lambda_is_in_the_rows_of_both_sets_of_experts():
    now, before, _ = both_sets("ablations")
    lambdas = ("lambda-0.2", "lambda-0.4", "ta-s", "lambda-0.8", "lambda-1.0")
    at, earlier = kept(now, *lambdas), kept(before, *lambdas)
    blocks = kept(now, "kept-0", "ta-s", "kept-2")
    page = " ".join((ROOT / "docs/mergevla.md").read_text(encoding="utf-8").split())
    for said in (
        f"the trunk keeps {now['only-trunk']['kept']} of the experts' success, the backbone "
        f"{now['only-backbone']['kept']}, both together {now['ta-s']['kept']}.",
        f"vision keeps {now['only-vision']['kept']}, the projector {kept(now, 'only-projector')[0]}, the language "
        f"model {now['only-language']['kept']}. Together they cost {100 - int(kept(now, 'only-backbone')[0])} points, "
        f"most of it in StackCube, which has {now['only-backbone']['weakest'].split()[1]} % left",
        f"none {blocks[0]} %, one {blocks[1]}, two {blocks[2]}, three of four {now['kept-3']['kept']},",
        f"{at[0]} % at 0.2, {at[1]} at 0.4, {at[2]} at 0.6, {at[3]} at 0.8, {at[4]} at 1.",
        f"the best lambda was 0.6, with {earlier[2]} % (0.8: {earlier[3]}, 1: {earlier[4]})",
        f"({before['only-language']['kept']} kept; backbone {kept(before, 'only-backbone')[0]}, trunk "
        f"{kept(before, 'only-trunk')[0]};",
    ):
        assert said in page
    assert max(earlier, key=int) == earlier[2]


def test_what_the_page_says_of_routers_is_in_the_rows():
    found = rows("routers")
    shipped, averaged = (
        {row["router"]: row for row in found if row["model"] == model} for model in (routers.SHIPPED, routers.AVERAGED)
    )

    def right(row):
        return [float(row[instruction].partition(" ")[0]) for instruction in ("read", "hidden")]

    paper, own = right(shipped["paper-coded"]), right(averaged["paper-coded"])
    others = [right(row) for row in found if row["router"].startswith("paper-") and row["router"] != "paper-coded"]
    best = [max(rates) for rates in zip(*others, strict=True)]
    energy, standard = right(shipped["delta-energy"]), right(shipped["the same, standardised"])
    unlabelled, supervised = right(shipped["self-trained"]), right(shipped["calibrated"])
    chosen = shipped["calibrated"]["decisions, hidden"]
    pair = {"3", "4"}
    wrong = [{choice, str(place // 100)} for place, choice in enumerate(chosen) if int(choice) != place // 100]
    more = shipped["calibrated, all patches and more frames"]
    labels = shipped["self-trained"]["decisions, hidden"]
    alone = [labels[100 * task : 100 * task + 100].count(str(task)) for task in range(9)]
    page = " ".join((ROOT / "docs/mergevla.md").read_text(encoding="utf-8").split())
    for said in (
        f"is right in {paper[0]:.0f} % of first observations here, and in {paper[1]:.0f} % without",
        f"reaches {unlabelled[0]:.1f} and {unlabelled[1]:.1f} %, the supervised one {supervised[0]:.0f} and "
        f"{supervised[1]:.1f} %",
        f"right in {paper[0]:.0f} % with the instruction read and {paper[1]:.0f} % hidden, on the paper's own merge in "
        f"{own[0]:.0f} and {own[1]:.0f}.",
        f"reach {best[0]:.0f} % read and {best[1]:.0f} % hidden",
        f"(`delta-energy`, {energy[0]:.0f} % read and {energy[1]:.0f} % hidden",
        f"row spaces are right in {standard[0]:.1f} and {standard[1]:.0f} %",
        f"{unlabelled[0]:.1f} % read, {unlabelled[1]:.1f} % hidden, against {supervised[0]:.0f} and "
        f"{supervised[1]:.1f}",
        f"are right in {right(shipped['the same, of layers that read images, standardised'])[1]:.1f} %, their sum with",
        f"agreement of actions in {right(shipped['these three, standardised'])[1]:.1f} %; self-training on that sum "
        f"gives {unlabelled[1]:.1f} %, but only {alone[1]} % in PushCube and {alone[3]} % in PandaPickAndPlace",
        f"it reaches {unlabelled[0]:.1f} % (above)",
        f"of {len(wrong)} mistakes of `calibrated` in {len(chosen)}, {sum(one == pair for one in wrong)} are between",
        f"are right on {shipped['calibrated']['one scene, hidden']} of it",
        f"on {more['one scene, hidden']}, which shows no difference",
    ):
        assert said in page


def test_what_the_page_says_of_held_out_losses_is_in_the_rows():
    loss = {row["way"]: row["mean"] for row in rows("merges")}
    base = loss["base (joint training)"]
    success = {row["policy"]: row["success"].partition(" %")[0] for row in rows("operators")}
    said = [f"{loss[way]:.3f}".lstrip("0") for way in ("TSV, no masks, k = 1", "TSV+S, k = 1")]
    trunk = [f"{loss[f'{way}, averaged trunk, k = 1']:.3f}".lstrip("0") for way in ("own adapters", "TA+S")]
    page = " ".join((ROOT / "docs/mergevla.md").read_text(encoding="utf-8").split())
    assert (
        f"the base ({said[1]} and .{1000 * base:03.0f}), and more success ({success['tsv-s']} and {success['joint']}"
        in page
    )
    assert base < loss["TSV+S, k = 1"]
    assert f"({said[0]}, with masks {said[1]}). The averaged trunk loses as much if" in page
    assert f"at all ({trunk[0]}) as if they are ({trunk[1]})" in page


@pytest.mark.simulator
@pytest.mark.parametrize("task", ["maniskill/PlaceSphere-v1", "pybullet/PandaStack-v3", "robosuite/PickPlaceCan"])
def test_a_task_that_no_policy_has_seen_can_be_looked_at(task, monkeypatch):
    for simulator, names in (("maniskill", ("TASKS", "LAYOUTS")), ("robosuite", ("TASKS", "PARTS"))):
        adapter = importlib.import_module(f"robogauntlet.adapters.{simulator}.simulation")
        for name in names:
            monkeypatch.setattr(adapter, name, dict(getattr(adapter, name)))
    simulation = unknown_scenes.open_scene(task, EXPERT_VIEW)
    simulation.reset(0)
    assert simulation.observe().instruction == unknown_scenes.REPORTED[task]
    simulation.close()


def test_what_the_page_says_of_unknown_tasks_is_in_the_rows():
    found = {(row["detector"], row["unknown task"].rpartition("/")[2]): row for row in rows("unknown_tasks")}

    def said(detector, task, *what):
        return [found[detector, task][name].removeprefix("0") for name in what]

    read, hidden, rejected = "AUROC, instruction read", "AUROC, instruction hidden", "rejected, instruction read"
    mean, slide = (said("calibrated", task, read, rejected) for task in ("mean", "PandaSlide-v3"))
    near = [said("calibrated", task, hidden)[0] for task in ("PlaceSphere-v1", "PandaSlide-v3")]
    blind = said("calibrated", "mean", hidden, "rejected, instruction hidden")
    labelled = said("self-trained", "mean", read, hidden)
    layers, patches = (
        said(name, "mean", hidden, read) for name in ("calibrated, all layers", "all layers and patches")
    )
    page = " ".join((ROOT / "docs/mergevla.md").read_text(encoding="utf-8").split())
    for text in (
        f"AUROC {mean[0]} on average, {mean[1]} rejected.",
        f"resemble PandaPush's ({slide[0]}, {slide[1]} rejected)",
        f"{blind[0]} on average, {blind[1]} rejected; PlaceSphere and PandaSlide are near chance ({near[0]}, "
        f"{near[1]})",
        f"is a little below ({labelled[0]} and {labelled[1]})",
        f"make it {layers[0]}, distances of single patches as well {patches[0]} (.90 was",
        f"worse than `calibrated` ({layers[1]} and {patches[1]}, mostly",
    ):
        assert text in page


def test_what_the_page_says_of_routers_under_shift_is_in_the_rows():
    found = {(row["router"], row["instruction"]): row for row in rows("shifted_routing")}
    kept, plain, last = (
        f"calibrated, {layer} layer, {frames} frames"
        for layer, frames in (("middle", "augmented"), ("middle", "unmodified"), ("last", "augmented"))
    )
    words, unmodified = (found[one, "read"]["sentences"] for one in (kept, plain))
    shifted = [
        f"{found[kept, 'hidden'][shift].split()[0]}{unit} instead of {found[plain, 'hidden'][shift].split()[0]}"
        for shift, unit in (("light", " %"), ("camera", ""), ("all three", ""))
    ]
    unseen = [found[one, reads]["AUROC"] for reads in ("hidden", "read") for one in (kept, last)]
    page = " ".join((ROOT / "docs/mergevla.md").read_text(encoding="utf-8").split())
    for text in (
        f"is right in {words}, fitted to unmodified frames in {unmodified}.",
        f"it is right in {found[kept, 'hidden']['sentences']}, so with",
        f"in other light {shifted[0]}, from another camera {shifted[1]}, under all three {shifted[2]}.",
        f"(AUROC {unseen[0][1:]} and {unseen[1][1:]} with the instruction hidden, {unseen[2]} and {unseen[3][1:]} with",
    ):
        assert text in page
