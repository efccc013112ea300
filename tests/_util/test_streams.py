"""Generators put at the start of their streams together are NumPy's own."""

import numpy as np
import pytest

from ves_gym._util.streams import reseed


def fresh(n):
    return [np.random.Generator(np.random.PCG64(0)) for _ in range(n)]


@pytest.mark.parametrize("words", [1, 2, 3, 4])
def test_states_are_those_of_numpy(words):
    """Zeros, the largest words, and random ones; what a generator had drawn is forgotten."""
    rng = np.random.default_rng(0)
    keys = rng.integers(0, 2**32, (50, words), dtype=np.uint64)
    keys[0], keys[1], keys[2] = 0, 2**32 - 1, np.arange(words)
    used = fresh(50)
    for generator in used:
        generator.integers(0, 10, dtype=np.int32)  # leaves half a number behind
    for generator, key in zip(reseed(used, keys), keys.tolist(), strict=True):
        numpy = np.random.Generator(np.random.PCG64(np.random.SeedSequence(tuple(key))))
        assert generator.bit_generator.state == numpy.bit_generator.state
        assert generator.random(3).tobytes() == numpy.random(3).tobytes()


@pytest.mark.parametrize("n", [1, 20])
def test_few_and_large_keys_take_numpys_way(n):
    keys = np.arange(3 * n, dtype=np.uint64).reshape(n, 3) + np.uint64(2**40)
    for generator, key in zip(reseed(fresh(n), keys), keys.tolist(), strict=True):
        numpy = np.random.PCG64(np.random.SeedSequence(tuple(key)))
        assert generator.bit_generator.state == numpy.state
