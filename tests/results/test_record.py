"""Tests of results/record.py."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.record import (
    BEHAVIOUR,
    FIELDS,
    LATER,
    OUTCOME,
    TELEMETRY,
    EpisodeResult,
    FailureKind,
    Status,
    describe_fields,
    known_kind,
    outcome_row,
    outcome_text,
    rows_hash,
)
from robogauntlet.suites.episode import ProtocolName, SuccessRule
from tests.results.synthetic import cells, row, rows

EPISODE = cells()[0].episode(3)
ROW = row(cells()[0], 3)


@pytest.mark.parametrize("name", FIELDS)
def test_every_field_has_a_sentence_and_a_type(name):
    kind, _, sentence = describe_fields()[name]
    assert kind in (str, int, float, bool)
    assert sentence.endswith(".")
    assert len(sentence.split()) > 1


def test_fields_are_outcome_or_telemetry_and_only_some_may_be_none():
    assert set(OUTCOME) | set(TELEMETRY) == set(FIELDS)
    assert not set(OUTCOME) & set(TELEMETRY)
    described = describe_fields()
    routing = {"inferred_task", "routing_scores", "unknown_score", "rejected"}
    answers = {"query_p50_s", "query_p95_s", "query_max_s"}
    optional = {*routing, *answers, *BEHAVIOUR, *LATER, "delivered", "delivered_statistics", "error"}
    assert {name for name in FIELDS if described[name][1]} == optional


def test_a_record_carries_the_identity_of_its_episode():
    assert (ROW.episode_id, ROW.pair_id, ROW.simulator) == (EPISODE.id, EPISODE.pair_id, "maniskill")
    assert (ROW.seed, ROW.horizon, ROW.cameras, ROW.render_profile) == (3, 100, "third_person,wrist", "standard")


def test_an_episode_that_could_not_be_played_is_an_error_with_its_reason():
    failed = EpisodeResult.failed_to_run(EPISODE, "WorkerDied: signal 11", attempts=3)
    assert (failed.status, failed.error, failed.attempts) == (Status.ERROR, "WorkerDied: signal 11", 3)
    assert failed.steps == 0
    assert not failed.success_once


@pytest.mark.parametrize("text", ["a\x00b", "a\ud800b"])
def test_an_error_message_can_always_be_stored(text):
    error = EpisodeResult.failed_to_run(EPISODE, text).error
    assert error == "a�b"


changes = {str: "something else", int: 987_654, float: 0.123456, bool: None}


def changed(result, name):
    value = getattr(result, name)
    new = changes[describe_fields()[name][0]]
    return dataclasses.replace(result, **{name: (not value) if new is None else new})


@given(st.permutations([row(cell, seed) for cell in cells() for seed in range(2)]))
def test_the_hash_of_rows_ignores_their_order(shuffled):
    original = [row(cell, seed) for cell in cells() for seed in range(2)]
    assert rows_hash(map(outcome_row, shuffled)) == rows_hash(map(outcome_row, original))


@pytest.mark.parametrize("name", TELEMETRY)
def test_the_hash_of_rows_ignores_telemetry(name):
    assert changed(ROW, name) != ROW
    assert rows_hash([outcome_row(changed(ROW, name))]) == rows_hash([outcome_row(ROW)])


@pytest.mark.parametrize("name", OUTCOME)
def test_the_hash_of_rows_changes_with_every_outcome_field(name):
    assert rows_hash([outcome_row(changed(ROW, name))]) != rows_hash([outcome_row(ROW)])


@given(st.text(st.characters(codec="utf-8")), st.integers(0, 2**40), st.floats(-1e6, 1e6), st.booleans())
def test_the_hash_of_rows_differs_for_any_two_outcomes(text, steps, reward, once):
    other = dataclasses.replace(ROW, error=text, steps=steps, reward_sum=reward, success_once=once)
    same = outcome_row(other) == outcome_row(ROW)
    assert (rows_hash([outcome_row(other)]) == rows_hash([outcome_row(ROW)])) == same


def test_the_hash_of_rows_leaves_out_a_behaviour_that_was_not_measured():
    results = rows(planned=3, errors=1)
    assert rows_hash(map(outcome_row, results)) == "f273f4cf173fdee0"
    results[1] = dataclasses.replace(results[1], contact_steps=0)
    assert rows_hash(map(outcome_row, results)) != "f273f4cf173fdee0"


@pytest.mark.parametrize("name", BEHAVIOUR)
def test_a_row_with_any_measured_behaviour_is_hashed_with_all_of_it(name):
    value = {str: "dropped", int: 0, float: -0.0}[describe_fields()[name][0]]
    found = outcome_row(dataclasses.replace(ROW, **{name: value}))
    hashed = [field for field in OUTCOME if field not in LATER]
    assert len(found) == len(outcome_row(ROW)) + len(BEHAVIOUR) == len(hashed)
    assert str(found[hashed.index(name)]) in ("dropped", "0", "0.0")


def test_a_row_keeps_the_protocol_of_its_episode_and_is_hashed_with_it():
    protocol = dataclasses.replace(EPISODE.protocol, name=ProtocolName.OPENVLA)
    other = EpisodeResult.failed_to_run(dataclasses.replace(EPISODE, protocol=protocol), "")
    assert (other.protocol, ROW.protocol) == ("openvla", None)
    assert other.episode.protocol == protocol
    assert other.episode.id == other.episode_id != ROW.episode_id
    assert len(outcome_row(other)) == len(outcome_row(ROW)) + 1


def test_a_row_keeps_another_rule_than_its_protocols_own_and_is_hashed_with_it():
    protocol = dataclasses.replace(EPISODE.protocol, success=SuccessRule.ONCE)
    other = EpisodeResult.failed_to_run(dataclasses.replace(EPISODE, protocol=protocol), "")
    assert (other.success_rule, ROW.success_rule) == ("once", None)
    assert other.episode.protocol == protocol
    assert other.episode.id == other.episode_id != ROW.episode_id
    assert len(outcome_row(other)) == len(outcome_row(ROW)) + 1


def test_every_kind_of_failure_has_a_word_of_its_own():
    assert len({str(kind) for kind in FailureKind}) == len(FailureKind) == 7


def test_the_hash_of_rows_counts_a_row_that_is_there_twice():
    assert rows_hash([outcome_row(ROW)] * 2) != rows_hash([outcome_row(ROW)])


def test_a_reward_hashes_the_same_however_a_database_returns_it():
    """SQLite returns -0.0 as 0.0, and a worker may hand over a whole number."""
    hashes = {rows_hash([outcome_row(dataclasses.replace(ROW, reward_sum=zero))]) for zero in (0, 0.0, -0.0)}
    assert len(hashes) == 1


@pytest.mark.parametrize(
    ("status", "failure", "shown"),
    [
        ("failure", "dropped", "failure: dropped"),
        *[("failure", unknown, "failure") for unknown in (None, "", "melted", float("nan"))],
        ("success", "dropped", "success"),
    ],
)
def test_a_caption_names_a_known_kind_of_a_failure(status, failure, shown):
    assert outcome_text(status, failure) == shown


def test_every_kind_is_known():
    assert {known_kind(str(kind)) for kind in FailureKind} == set(FailureKind)
