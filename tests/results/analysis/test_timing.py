"""How long policies take to answer, from the rows."""

from robogauntlet.results.analysis.timing import AnswerTiming, answer_timing
from tests.results.synthetic import cells, frame_of, row


def times(seed, median, late, longest):
    return row(cells()[0], seed, query_p50_s=median, query_p95_s=late, query_max_s=longest)


def test_a_policys_times_are_typical_of_its_episodes_but_for_the_longest():
    frame = frame_of([times(0, 0.1, 0.3, 0.4), times(1, 0.2, 0.4, 9.0), times(2, 0.3, 0.5, 0.6), row(cells()[0], 3)])
    assert answer_timing(frame) == (AnswerTiming(cells()[0].policy, 3, 0.2, 0.4, 9.0),)


def test_rows_of_before_there_were_such_times_have_none():
    frame = frame_of([row(cells()[0], 0)])
    assert answer_timing(frame) == ()
