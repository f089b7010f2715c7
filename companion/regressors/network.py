"""Fully connected networks of one shape, several side by side: answer, gradient step, state."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel
from companion.kernel.parts import Arrays

Tensor = NDArray[np.float32]

RATE = 2e-3
DECAYS = 0.9, 0.999
"""Adam's (Kingma and Ba, 2015), with the weight decay beside the gradient (AdamW)."""
WEIGHT_DECAY = 1e-3
WARM_UP_STEPS = 100
AVERAGE = 0.995
"""What answers is the mean of the weights over about the last 200 steps: steadier than the last."""
NOISE = 0.3
"""Added to the inputs, in their standard deviations: no network may trust a single feature."""
DROPOUT = 0.1
HUBER = 0.3
"""Error in standard deviations beyond which it counts linearly: labels have outliers."""


class Network:
    """``n_networks`` rectified networks with layers of ``sizes``; inputs and outputs are scaled."""

    def __init__(self, sizes: tuple[int, ...], n_networks: int, rng: np.random.Generator) -> None:
        self.n_steps = 0
        self._layers = len(sizes) - 1
        self._parameters: list[Tensor] = []
        for n_in, n_out in pairwise(sizes):
            weights = rng.normal(0.0, np.sqrt(2.0 / n_in), (n_networks, n_in, n_out))
            self._parameters.append(weights.astype(np.float32))
            self._parameters.append(np.zeros((n_networks, 1, n_out), dtype=np.float32))
        self._averages = [values.copy() for values in self._parameters]
        self._first = [np.zeros_like(values) for values in self._parameters]
        self._second = [np.zeros_like(values) for values in self._parameters]

    def answer(self, inputs: Tensor) -> Tensor:
        """Of each network to each row of ``inputs`` (n, n_features): (n_networks, n)."""
        values = inputs[np.newaxis]
        for layer in range(self._layers):
            weights, offsets = self._averages[2 * layer : 2 * layer + 2]
            values = values @ weights + offsets
            if layer < self._layers - 1:
                values = np.maximum(values, 0.0)
        return values[..., 0]

    def step(self, inputs: Tensor, wanted: Tensor, rng: np.random.Generator) -> None:
        """One step down the error: inputs (n_networks, n, n_features), wanted (n_networks, n)."""
        noise = rng.standard_normal(inputs.shape, dtype=np.float32) * np.float32(NOISE)
        values, kept = [inputs + noise], []
        for layer in range(self._layers - 1):
            raw = values[-1] @ self._parameters[2 * layer] + self._parameters[2 * layer + 1]
            mask = (raw > 0.0) & (rng.random(raw.shape, dtype=np.float32) >= DROPOUT)
            kept.append(mask * np.float32(1.0 / (1.0 - DROPOUT)))
            values.append(raw * kept[-1])
        answer = (values[-1] @ self._parameters[-2] + self._parameters[-1])[..., 0]
        error = np.clip(answer - wanted, -HUBER, HUBER) / np.float32(HUBER * wanted.shape[1])
        self._descend(self._gradients(values, kept, error[..., np.newaxis]))

    def _gradients(self, values: list[Tensor], kept: list[Tensor], error: Tensor) -> list[Tensor]:
        gradients: list[Tensor] = []
        for layer in reversed(range(self._layers)):
            gradients.append(error.sum(axis=1, keepdims=True))
            gradients.append(values[layer].transpose(0, 2, 1) @ error)
            if layer > 0:
                error = (error @ self._parameters[2 * layer].transpose(0, 2, 1)) * kept[layer - 1]
        return gradients[::-1]

    def _descend(self, gradients: list[Tensor]) -> None:
        self.n_steps += 1
        rate = RATE * min(1.0, self.n_steps / WARM_UP_STEPS)
        early, late = (1.0 - decay**self.n_steps for decay in DECAYS)
        # The mean of few steps must not remember the random start.
        share = max(1.0 - AVERAGE, 1.0 / (self.n_steps + 1.0))
        size = rate * math.sqrt(late) / early
        decay = np.float32(1.0 - rate * WEIGHT_DECAY)
        for place, gradient in enumerate(gradients):
            _update(
                self._parameters[place].reshape(-1),
                self._averages[place].reshape(-1),
                self._first[place].reshape(-1),
                self._second[place].reshape(-1),
                gradient.reshape(-1),
                np.float32(size),
                decay,
                np.float32(share),
            )

    def state(self) -> Arrays:
        """Weights, their averages and the optimiser's moments."""
        return {
            f"{name}.{place}": values.copy()
            for name, parts in self._named().items()
            for place, values in enumerate(parts)
        }

    def restore(self, state: Arrays, n_steps: int) -> None:
        """Takes up where ``state`` was taken, after ``n_steps``."""
        self.n_steps = n_steps
        for name, parts in self._named().items():
            parts[:] = [
                np.array(state[f"{name}.{place}"], dtype=np.float32) for place in range(len(parts))
            ]

    def _named(self) -> dict[str, list[Tensor]]:
        return {
            "weights": self._parameters,
            "averages": self._averages,
            "first": self._first,
            "second": self._second,
        }


# One pass over memory instead of a dozen: this is most of the time of a step.
@kernel("void(f4[::1], f4[::1], f4[::1], f4[::1], f4[::1], f4, f4, f4)", fast=True)
def _update(
    values: Tensor,
    averages: Tensor,
    first: Tensor,
    second: Tensor,
    gradient: Tensor,
    size: np.float32,
    decay: np.float32,
    share: np.float32,
) -> None:
    keep_first, keep_second = np.float32(DECAYS[0]), np.float32(DECAYS[1])
    one, floor = np.float32(1.0), np.float32(1e-8)
    for place in range(len(values)):
        slope = gradient[place]
        first[place] = keep_first * first[place] + (one - keep_first) * slope
        second[place] = keep_second * second[place] + (one - keep_second) * slope * slope
        moved = decay * values[place] - size * first[place] / (np.sqrt(second[place]) + floor)
        values[place] = moved
        averages[place] += share * (moved - averages[place])
