"""Blocks by age: nothing is lost, nothing counted twice, and onsets are told apart to a fraction of their age."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from servohil.estimators.leakage.information import CYCLES, INFORMATION_SIZE, RIGHT
from servohil.estimators.leakage.onsets import (
    LEVELS,
    MAX_BLOCKS,
    ONSETS_SIZE,
    PER_LEVEL,
    block_at,
    clear,
    push,
)


def numbered(number: int) -> np.ndarray:
    block = np.zeros(INFORMATION_SIZE)
    block[RIGHT] = number
    block[CYCLES] = 1.0
    return block


def contents(onsets: np.ndarray) -> list[np.ndarray]:
    """The blocks, the youngest first."""
    found = []
    for age in range(MAX_BLOCKS + 1):
        place = block_at(onsets, age)
        if place < 0:
            break
        found.append(onsets[place : place + INFORMATION_SIZE].copy())
    return found


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 3 * PER_LEVEL * 2**LEVELS))
def test_every_block_is_in_one_place_in_order(pushed: int) -> None:
    onsets, leaving, history = np.zeros(ONSETS_SIZE), np.zeros(INFORMATION_SIZE), np.zeros(INFORMATION_SIZE)
    for number in range(1, pushed + 1):
        if push(onsets, numbered(number), leaving):
            history += leaving
    blocks = contents(onsets)
    lengths = [int(block[CYCLES]) for block in blocks]
    assert sum(lengths) + history[CYCLES] == pushed
    newest = pushed  # the sum of consecutive numbers tells which they are
    for block, length in zip(blocks, lengths, strict=True):
        assert block[RIGHT] == sum(range(newest - length + 1, newest + 1))
        newest -= length
    assert history[RIGHT] == sum(range(1, newest + 1))
    assert lengths == sorted(lengths) and all(length & (length - 1) == 0 for length in lengths)
    age = 0
    for length in lengths:
        assert length <= max(1, age)  # an onset of some age is known to that age
        age += length


def test_clear() -> None:
    onsets, leaving = np.zeros(ONSETS_SIZE), np.zeros(INFORMATION_SIZE)
    for number in range(20):
        push(onsets, numbered(number), leaving)
    assert contents(onsets) != []
    clear(onsets)
    assert contents(onsets) == []
