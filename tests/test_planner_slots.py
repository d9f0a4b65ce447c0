"""Every node has slots of its own, wherever a search comes to it, and none before."""

import numpy as np

from planner.compiled import slot_of, slots_for, slots_of, take_slot


def test_nodes_get_slots_of_their_own_in_the_order_they_are_come_to():
    slots = slots_for(1000)
    nodes = np.random.default_rng(0).permutation(1000)
    taken = np.array([take_slot(slots, int(node)) for node in nodes])
    assert len(np.unique(taken)) == 1000
    assert 128 <= taken.min() <= taken.max() < slots.length
    np.testing.assert_array_equal(slots_of(slots, nodes), taken)
    # The first block of 128 that was come to lies first, with its nodes in their order.
    assert taken[0] == 128 + nodes[0] % 128
    assert [take_slot(slots, int(node)) for node in nodes] == taken.tolist()


def test_a_node_that_was_not_come_to_has_a_slot_that_no_node_is_given():
    slots = slots_for(1000)
    assert {slot_of(slots, node) // 128 for node in range(1000)} == {0}
    take_slot(slots, 130)
    assert slot_of(slots, 128) // 128 == 1
    assert slot_of(slots, 127) // 128 == 0
    assert slots.used[0] == 1
