"""From a command line's options to an architecture."""

from policies.mergevla.config import TINY, Quirks
from policies.training.options import architecture_of


def test_by_default_the_network_is_the_repaired_one():
    assert architecture_of("tiny") == TINY


def test_quirks_are_switched_on_one_by_one_or_all_at_once():
    assert architecture_of("tiny", ["shifted_slices"]).quirks == Quirks(shifted_slices=True)
    assert architecture_of("tiny", ["paper"]).quirks == Quirks.paper()


def test_self_attention_and_gate_are_chosen_apart():
    control = architecture_of("tiny", self_attention=True).expert
    assert (control.self_attention, control.gates_by_tanh) == (True, True)
    mixed = architecture_of("tiny", self_attention=True, gate="sigmoid").expert
    assert (mixed.self_attention, mixed.gates_by_tanh) == (True, False)
    assert architecture_of("tiny", gate="tanh").expert.gates_by_tanh
