"""The arena: named views of one block, saved and restored as bytes."""

import numpy as np
import pytest

from servohil.hil.arena import Arena


def test_views_do_not_overlap_and_fill_the_block() -> None:
    arena = Arena({"a": 3, "b": 2}, {"c": 4})
    for number, view in enumerate([*arena.f8.values(), *arena.i8.values()], start=1):
        view[:] = number
    assert arena.f8["a"].tolist() == [1.0] * 3
    assert arena.f8["b"].tolist() == [2.0] * 2
    assert arena.i8["c"].tolist() == [3] * 4
    assert sum(v.size for v in (*arena.f8.values(), *arena.i8.values())) == arena.block.size


def test_restore_brings_back_every_bit_also_nan_and_negative_zero() -> None:
    arena = Arena({"a": 3}, {"c": 1})
    arena.f8["a"][:] = [np.nan, -0.0, 1e-310]
    arena.i8["c"][0] = -(2**63)
    saved = arena.save()
    arena.block[:] = 7.0
    arena.restore(saved)
    assert arena.save() == saved
    assert np.isnan(arena.f8["a"][0]) and np.signbit(arena.f8["a"][1]) and arena.i8["c"][0] == -(2**63)


def test_a_checkpoint_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="24 bytes, this controller's state has 16"):
        Arena({"a": 2}, {}).restore(b"\0" * 24)
