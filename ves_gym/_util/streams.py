"""Many of NumPy's random generators at once, in the very states that NumPy would give them.

`PCG64(SeedSequence((a, b, c)))` takes some 10 us a generator, most of it on the way into C.
Here the words of all generators are mixed together (O'Neill's seed_seq, as NumPy's
bit_generator.pyx has it; the seeding of PCG64 as in its pcg64.h).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Words = npt.NDArray[np.uint32]

_FEW = 12  # generators below which NumPy's own way is as fast
_START_A, _TIMES_A = 0x43B0D7E5, 0x931E8875
_START_B, _TIMES_B = 0x8B51F9DD, 0x58F38DED
_LEFT, _RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_SHIFT = np.uint32(16)
_PCG = 0x2360ED051FC65DA44385DF649FCCF645


def reseed(
    generators: Sequence[np.random.Generator], keys: npt.NDArray[np.uint64]
) -> list[np.random.Generator]:
    """Put generators at the start of the streams of their keys.

    Args:
        generators: of PCG64, one per key.
        keys: (n, m) whole numbers, as a `SeedSequence` takes them.

    Returns:
        The same generators; new ones where that is as fast.
    """
    if len(keys) < _FEW or (keys >> np.uint64(32)).any():
        sequences = map(np.random.SeedSequence, map(tuple, keys.tolist()))
        return [np.random.Generator(np.random.PCG64(s)) for s in sequences]
    high, low, inc_high, inc_low = _state(keys.astype(np.uint32)).T
    unit = np.uint64(1)
    increment = _Wide(inc_high << unit | inc_low >> np.uint64(63), inc_low << unit | unit)
    states = (increment + _Wide(high, low)) * _PCG + increment
    inner: dict[str, int] = {}
    outer = {"bit_generator": "PCG64", "state": inner, "has_uint32": 0, "uinteger": 0}
    for generator, state, step in zip(
        generators, states.numbers(), increment.numbers(), strict=True
    ):
        inner["state"], inner["inc"] = state, step
        generator.bit_generator.state = outer
    return list(generators)


@dataclass(frozen=True)
class _Wide:
    """Whole numbers of 128 bits, modulo 2^128."""

    high: npt.NDArray[np.uint64]
    low: npt.NDArray[np.uint64]

    def __add__(self, other: _Wide) -> _Wide:
        low = self.low + other.low
        return _Wide(self.high + other.high + (low < self.low), low)

    def __mul__(self, factor: int) -> _Wide:
        high, low = np.uint64(factor >> 64), np.uint64(factor & 0xFFFFFFFFFFFFFFFF)
        half, mask = np.uint64(32), np.uint64(0xFFFFFFFF)
        a, b, c, d = self.low >> half, self.low & mask, low >> half, low & mask
        # the upper half of low times low, by halves of each
        across = a * d + (b * d >> half)
        carried = b * c + (across & mask)
        upper = a * c + (across >> half) + (carried >> half)
        return _Wide(upper + self.high * low + self.low * high, self.low * low)

    def numbers(self) -> list[int]:
        """As whole numbers of Python."""
        pairs = zip(self.high.tolist(), self.low.tolist(), strict=True)
        return [high << 64 | low for high, low in pairs]


def _state(words: Words) -> npt.NDArray[np.uint64]:
    """(n, 4) `SeedSequence(row).generate_state(4, uint64)` of rows of at most four words."""
    n, m = words.shape
    constant = _START_A

    def hashed(value: Words) -> Words:
        nonlocal constant
        value = value ^ np.uint32(constant)
        constant = constant * _TIMES_A & 0xFFFFFFFF
        value = value * np.uint32(constant)
        return value ^ (value >> _SHIFT)

    pool = [hashed(words[:, i] if i < m else np.zeros(n, np.uint32)) for i in range(4)]
    for source in range(4):
        for target in range(4):
            if source != target:
                mixed = _LEFT * pool[target] - _RIGHT * hashed(pool[source])
                pool[target] = mixed ^ (mixed >> _SHIFT)
    constant, out = _START_B, np.empty((n, 8), np.uint32)
    for i in range(8):
        value = pool[i % 4] ^ np.uint32(constant)
        constant = constant * _TIMES_B & 0xFFFFFFFF
        value = value * np.uint32(constant)
        out[:, i] = value ^ (value >> _SHIFT)
    return out.astype("<u4").view("<u8").astype(np.uint64)
