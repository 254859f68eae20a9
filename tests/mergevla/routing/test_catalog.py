"""Routers by name, and fitted ones on a small network."""

from dataclasses import replace

import pytest
import torch
from safetensors.torch import load, save

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.routing.catalog import FITTED, NAMES, UNFITTED, fit_routers, router
from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.features import FeatureSpec, Pooling, features_of, labelled_features
from robogauntlet_mergevla.routing.gaussian import GaussianRouterFit, fit
from robogauntlet_mergevla.spec import UNFITTED_ROUTERS
from tests.mergevla.routing.synthetic import EXPERTS, SmallMergedModel, frames, observation, observations


def test_the_catalog_has_every_router():
    assert set(UNFITTED) == set(UNFITTED_ROUTERS)
    assert set(NAMES) == {*UNFITTED, *FITTED}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "paper-coded:projections=q",
            r"router 'paper-coded:projections=q': expected options projections=v\|k\|kv, rank=",
        ),
        ("paper-coded:rank=1,rank=2", "expected each option once, got rank twice"),
        ("paper-coded:,", "rank=1 or more, block=0 or more, got ''"),
        (f"paper-coded:rank={'9' * 5000}", "rank=1 or more, block=0 or more, got 'rank=9"),
        ("paper-coded:rank=0", "rank=1 or more, block=0 or more, got 'rank=0'"),
        ("paper-written:block=-1", "got 'block=-1'"),
        ("paper-written:depth=1", "got 'depth=1'"),
        ("oracle:rank=2", "expected a router with options, paper-coded or paper-written, got 'oracle'"),
        ("paper-code:rank=2", "unknown router 'paper-code:rank=2'"),
    ],
)
def test_options_that_a_router_does_not_have_are_refused(name, message):
    with pytest.raises(PolicyError, match=message):
        router(name)


@pytest.mark.parametrize(("options", "message"), [("block=2", "block=0 to 1, got 2"), ("rank=17", "rank=1 to 16, got")])
def test_options_that_the_model_does_not_have_are_refused(options, message, model):
    with pytest.raises(PolicyError, match=message):
        router(f"paper-coded:{options}").route(observations(1), model)


def test_a_router_is_named_by_its_options():
    assert router("paper-coded:rank=16,projections=kv").name == "paper-coded:projections=kv,rank=16"
    assert router("paper-coded:projections=v,rank=8").name == "paper-coded"


LABELLED = ("calibrated", "nearest-centroid")


@pytest.mark.parametrize("name", LABELLED)
@pytest.mark.parametrize("sees_instruction", [True, False])
def test_fitted_routers_from_safetensors_route_new_frames_correctly(name, sees_instruction, model, stored):
    chosen = router(name, sees_instruction=sees_instruction, stored=load(save(stored)))
    new = [observation(9000 + i, task) for i in range(4) for task in EXPERTS]
    routed = chosen.route(new, model)
    assert [one.choice for one in routed] == [one.task for one in new]
    assert all(one.unknown is not None and one.rejected is not None for one in routed)


@pytest.mark.parametrize("name", FITTED)
def test_a_frame_of_no_known_task_is_rejected(name, model, stored):
    strange = observation(0)
    black = type(strange)(strange.images * 0, "", strange.proprioception, "0", strange.task)
    assert router(name, sees_instruction=False, stored=stored).route([black], model)[0].rejected


def test_the_calibrated_scores_are_log_probabilities(model, stored):
    for routed in router("calibrated", stored=stored).route(observations(), model):
        assert torch.tensor(list(routed.scores.values())).exp().sum() == pytest.approx(1.0)


def test_flat_features_keep_the_patches_positions_and_the_mean_does_not(model):
    batch, width = observations(5), 16
    patches = model.hidden_states(None, batch[0].images[None], [""]).task[-1].shape[1]
    shapes = {
        FeatureSpec(pooling=Pooling.FLAT): (patches + 1) * width,
        FeatureSpec(pooling=Pooling.MEAN): 2 * width,
        FeatureSpec(False, layer=0): 2 * width,
    }
    assert {r: features_of(model, batch, r).shape[1] for r in shapes} == shapes
    with pytest.raises(RoutingError, match="expected a layer from -3 to 2, got 3"):
        features_of(model, batch, FeatureSpec(layer=3))


def test_another_layer_is_stored(model):
    feature_spec = FeatureSpec(False, 1)
    parts = (labelled_features(model, part, feature_spec) for part in (frames(0, 4), frames(50, 4)))
    back = GaussianRouterFit.from_tensors(fit(*parts, feature_spec).as_tensors())
    assert back.feature_spec == FeatureSpec(False, 1)


@pytest.mark.parametrize("name", FITTED)
@pytest.mark.parametrize(("prefix", "sees_instruction"), [("instructed", True), ("unaided", False)])
def test_fitted_routers_use_the_middle_layer(name, prefix, sees_instruction, model, stored):
    assert model.architecture.language.layers == 2
    assert FeatureSpec.from_tensor(stored[f"{name}/{prefix}/reading"]) == FeatureSpec(sees_instruction, layer=1)


def test_half_a_sentence_is_routed_as_the_whole(model, stored):
    new = [observation(9000 + i, task) for i in range(4) for task in EXPERTS]
    short = [replace(one, instruction=" ".join(one.instruction.split()[::2])) for one in new]
    routed = router("calibrated", stored=stored).route(short, model)
    assert [one.choice for one in routed] == [one.task for one in new]


def test_the_message_for_a_misspelt_router_has_the_nearest_name():
    with pytest.raises(PolicyError, match="unknown router 'paper-code'; did you mean 'paper-coded'"):
        router("paper-code")


@pytest.mark.parametrize("name", FITTED)
def test_a_router_that_is_not_fitted_is_refused(name, stored):
    with pytest.raises(PolicyError, match=f"router '{name}': expected tensors {name}/unaided/.* got none"):
        router(name, sees_instruction=False, stored={})
    broken = {key: tensor for key, tensor in stored.items() if not key.endswith("centres")}
    with pytest.raises(PolicyError, match=f"router '{name}': expected centres"):
        router(name, stored=broken)


@pytest.mark.parametrize("name", FITTED)
def test_a_router_fitted_to_other_experts_is_refused(name, stored):
    with pytest.raises(PolicyError, match="got null/Push: the model has no expert of it"):
        router(name, stored=stored).route(observations(1), SmallMergedModel(EXPERTS[1:]))


def test_an_expert_without_frames_is_refused(model):
    with pytest.raises(RoutingError, match="expected first observations of expert null/Open, got none"):
        fit_routers(model, {**frames(0, 4), "null/Open": []}, frames(50, 4))


def test_the_message_for_a_router_of_another_format_says_what_to_do(stored):
    others = {key: tensor for key, tensor in stored.items() if not key.endswith("/whitening")}
    with pytest.raises(PolicyError, match=r"expected whitening .* got none; merge again with --demonstrations"):
        router("calibrated", stored=others)
