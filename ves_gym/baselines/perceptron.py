"""Actor and critic as two perceptrons in NumPy, with their derivatives written out.

Every number that is learned lies in one array of float32, `numbers`, and its derivative in
`slopes`; weights are views of them, so that an optimiser sees two vectors.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Layers = list[tuple[Floats, Floats]]  # weights (inputs, outputs) and offsets (outputs,)


class Perceptron:
    """Layers with an activation between them; their derivatives go to `slopes`."""

    def __init__(self, layers: Layers, slopes: Layers, activation: str) -> None:
        self.layers, self.slopes, self.activation = layers, slopes, activation
        self._buffers: dict[int, tuple[list[Floats], list[Floats], Floats]] = {}
        self._inputs: list[Floats] = []  # of every layer at the last call

    def __call__(self, x: Floats) -> Floats:
        """Outputs (b, outputs) of inputs (b, inputs); overwritten by the next call."""
        outputs = self._buffers_of(len(x))[0]
        self._inputs = [x]
        for k, ((W, b), out) in enumerate(zip(self.layers, outputs, strict=True)):
            np.matmul(self._inputs[k], W, out=out)
            out += b
            if k < len(self.layers) - 1:
                if self.activation == "tanh":
                    np.tanh(out, out=out)
                else:
                    np.maximum(out, 0, out=out)
                self._inputs.append(out)
        return out

    def backward(self, slope: Floats) -> None:
        """Set the derivatives of a number, given its by the outputs (b, outputs) last made."""
        _, slopes, ones = self._buffers_of(len(slope))
        for k in reversed(range(len(self.layers))):
            x, (W, _), (to_W, to_b) = self._inputs[k], self.layers[k], self.slopes[k]
            np.matmul(x.T, slope, out=to_W)
            np.matmul(ones, slope, out=to_b)
            if k:
                # BLAS takes eight times as long for the outer product of a single output
                product = np.multiply if slope.shape[1] == 1 else np.matmul
                slope = product(slope, W.T, out=slopes[k - 1])
                if self.activation == "tanh":
                    np.multiply(x, x, out=x)  # used up: 1 - tanh^2 is all that is needed
                    np.subtract(1, x, out=x)
                    slope *= x
                else:
                    slope *= x > 0

    def _buffers_of(self, rows: int) -> tuple[list[Floats], list[Floats], Floats]:
        if rows not in self._buffers:
            widths = [W.shape[1] for W, _ in self.layers]
            # an update calls this thousands of times with the same few numbers of rows
            outputs, slopes = (
                [np.empty((rows, k), np.float32) for k in widths] for _ in range(2)
            )
            self._buffers[rows] = outputs, slopes, np.ones(rows, np.float32)
        return self._buffers[rows]


class ActorCritic:
    """Means and spread of Gaussian actions, and values, of observations.

    Begins as Stable-Baselines3's policies do: orthogonal weights, actions next to zero.

    Args:
        sizes: observation, hidden layers (of either network), action.
        activation, log_std: tanh or relu, and of the actions' noise at first.
        rng: draws the weights.
        beside: numbers that the critic sees behind the observation.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        activation: str,
        log_std: float,
        rng: np.random.Generator,
        beside: int = 0,
    ) -> None:
        shapes = {"actor": sizes, "critic": (sizes[0] + beside, *sizes[1:-1], 1)}
        count = sum(
            (n + 1) * m for widths in shapes.values() for n, m in itertools.pairwise(widths)
        )
        self.numbers = np.zeros(count + sizes[-1], np.float32)
        self.slopes = np.zeros_like(self.numbers)
        self.log_std, self.log_std_slope = (a[: sizes[-1]] for a in (self.numbers, self.slopes))
        self.log_std[:] = log_std
        at, nets = sizes[-1], []
        for widths in shapes.values():
            layers: tuple[Layers, Layers] = ([], [])
            for n, m in itertools.pairwise(widths):
                for flat, views in zip((self.numbers, self.slopes), layers, strict=True):
                    W = flat[at : at + n * m].reshape(n, m)
                    views.append((W, flat[at + n * m : at + (n + 1) * m]))
                at += (n + 1) * m
            nets.append(Perceptron(*layers, activation))
        self.actor, self.critic = nets
        # the noise's numbers come first, the actor's after them
        self.actor_size = sizes[-1] + sum(W.size + b.size for W, b in self.actor.layers)
        for net, last in ((self.actor, 0.01), (self.critic, 1.0)):
            gains = [math.sqrt(2)] * (len(net.layers) - 1) + [last]
            for (W, _), gain in zip(net.layers, gains, strict=True):
                W[:] = gain * _orthogonal(W.shape, rng)

    def rescale(self, shift: Floats, factor: Floats) -> None:
        """Take inputs x as `factor` x + `shift` (inputs,) from now on, outputs unchanged."""
        for net in (self.actor, self.critic):
            W, b = net.layers[0]
            W = W[: len(factor)]
            b += shift @ W
            W *= factor[:, None]


def _orthogonal(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    n, m = shape
    Q, R = np.linalg.qr(rng.standard_normal((max(n, m), min(n, m))))
    Q *= np.sign(np.diag(R))
    return (Q if n >= m else Q.T).astype(np.float32)


class Adam:
    """Kingma & Ba's optimiser (arXiv:1412.6980), on a vector."""

    def __init__(self, size: int) -> None:
        self.steps = 0
        self.mean, self.square = np.zeros(size, np.float32), np.zeros(size, np.float32)

    def state(self) -> tuple[int, Floats, Floats]:
        """Everything that the next step depends on."""
        return self.steps, self.mean, self.square

    def restore(self, state: tuple[int, Floats, Floats]) -> None:
        """Go on from a state."""
        self.steps, self.mean[:], self.square[:] = state

    def step(self, numbers: Floats, slopes: Floats, rate: float) -> None:
        """Move `numbers` (k,) against their derivatives, in place."""
        a, b = 0.9, 0.999
        self.steps += 1
        self.mean += np.float32(1 - a) * (slopes - self.mean)
        self.square *= np.float32(b)
        self.square += np.float32(1 - b) * slopes * slopes
        size = np.sqrt(self.square)
        size *= np.float32(1 / math.sqrt(1 - b**self.steps))
        size += np.float32(1e-5)
        numbers -= np.float32(rate / (1 - a**self.steps)) * self.mean / size


def clipped(slopes: Floats, limit: float) -> float:
    """Shorten derivatives to a norm of at most `limit`, in place; their norm before."""
    norm = math.sqrt(float(slopes @ slopes))
    if norm > limit:
        slopes *= np.float32(limit / (norm + 1e-6))
    return norm
