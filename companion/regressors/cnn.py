"""The paper's convolutional network (appendix A), trained by replay while it flies. Needs PyTorch.

Three layers of 5x5 convolutions with 32, 32 and 128 kernels, each pooled 3x3 at every second pixel,
the first two normalised by their local contrast; two fully connected layers; squared error. The
paper scales images to 128x128 for a graphics card; here they are as vision.gradients shrinks
them, so that a step fits between two frames on one core.
"""

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import validate_data
from torch import nn

from companion.kernel.parts import Arrays, whole
from companion.regressors.base import Floats
from companion.regressors.online import Answer
from companion.regressors.replay import ReplayRegressor, draw_evenly
from companion.vision.gradients import HEIGHT_PX, WIDTH_PX

KERNELS = 32, 32, 128
KERNEL_PX = 5
HIDDEN = 64
RATE = 1e-3
AVERAGE = 0.99
"""What answers is the mean of the weights over about the last 100 steps: steadier than the last."""
MID_GREY, GREY_SPREAD = 128.0, 64.0
ERROR_EDGES = np.linspace(-1.5, 2.5, 9)
"""Of the ranges of estimates, in deviations from the mean, whose errors are followed apart."""
ERROR_RATE = 0.01
"""Least weight of the newest error in its range's running mean."""
BALANCE = 0.5
"""Rare targets are drawn more often: see draw_evenly."""
CHUNK = 64
"""Images answered at once: bounds the memory that many queries take."""

# One core, as all of perception: results must not depend on the machine, and frames are small.
torch.set_num_threads(1)


class CNNRegressor(ReplayRegressor):
    """Rows of ``X`` are images (height * width,) of grey levels; the newest are remembered."""

    STORED = np.uint8

    def __init__(
        self,
        height: int = HEIGHT_PX,
        width: int = WIDTH_PX,
        batch: int = 8,
        n_steps: int = 1,
        capacity: int = 10_000,
        random_state: int = 0,
    ) -> None:
        self.height = height
        self.width = width
        self.batch = batch
        self.n_steps = n_steps
        self.capacity = capacity
        self.random_state = random_state

    def _checked(
        self, X: ArrayLike, y: ArrayLike, *, reset: bool
    ) -> tuple[NDArray[np.float32], Floats]:
        samples, targets = validate_data(
            self, X, y, dtype=np.float32, order="C", y_numeric=True, reset=reset
        )
        if samples.shape[1] != self.height * self.width:
            raise ValueError(
                f"X has {samples.shape[1]} features; images of {self.width} x {self.height} have "
                f"{self.height * self.width}"
            )
        return samples, np.asarray(targets, dtype=np.float64)

    def _answer(self, X: ArrayLike) -> Answer:
        """Spread: the usual error of new samples that were estimated alike."""
        samples = validate_data(self, X, dtype=np.float32, reset=False)
        scaled = self._asked(samples)
        mean: Floats = scaled * self.outputs_.scale[0] + self.outputs_.mean[0]
        return mean, lambda: np.sqrt(self.errors_[np.digitize(scaled, ERROR_EDGES)])

    def _arrays(self) -> Arrays:
        """Memory, errors, weights, their averages and the optimiser's moments."""
        arrays = self._memory_arrays(self.n_steps_)
        arrays |= {"errors": self.errors_.copy(), "error_counts": self.error_counts_.copy()}
        arrays |= whole(out=self.outputs_.state())
        for name, tensors in self._tensors().items():
            for place, tensor in enumerate(tensors):
                arrays[f"{name}.{place}"] = tensor.detach().numpy().copy()
        return arrays

    def _take_up(self, state: Arrays) -> None:
        self.n_steps_ = self._take_up_memory(state)
        for moments in self.optimiser_.state.values():
            moments["step"].fill_(self.n_steps_)
        self.errors_ = np.array(state["errors"], dtype=np.float64)
        self.error_counts_ = np.array(state["error_counts"], dtype=np.int64)
        with torch.no_grad():
            for name, tensors in self._tensors().items():
                for place, tensor in enumerate(tensors):
                    tensor.copy_(torch.from_numpy(np.array(state[f"{name}.{place}"])))

    def _start(self) -> None:
        rng = np.random.default_rng(self.random_state)
        self.network_ = make_network(self.height, self.width, rng)
        self.average_ = make_network(self.height, self.width, rng)
        self.optimiser_ = torch.optim.Adam(self.network_.parameters(), lr=RATE)
        for weights in self.network_.parameters():
            self.optimiser_.state[weights] = {
                "step": torch.zeros(()),
                "exp_avg": torch.zeros_like(weights),
                "exp_avg_sq": torch.zeros_like(weights),
            }
        self.n_steps_ = 0
        self.errors_ = np.zeros(len(ERROR_EDGES) + 1)
        self.error_counts_ = np.zeros(len(ERROR_EDGES) + 1, dtype=np.int64)

    def _tensors(self) -> dict[str, list[torch.Tensor]]:
        """All that steps change."""
        moments = list(self.optimiser_.state.values())
        return {
            "weights": list(self.network_.parameters()),
            "averages": list(self.average_.parameters()),
            "first": [moment["exp_avg"] for moment in moments],
            "second": [moment["exp_avg_sq"] for moment in moments],
        }

    def _note_error(self, sample: NDArray[np.float32], target: float) -> None:
        """Of the first sample of a call, before it is learned from."""
        scaled = self._asked(sample)
        error = float(scaled[0]) * self.outputs_.scale[0] + self.outputs_.mean[0] - target
        place = int(np.digitize(scaled, ERROR_EDGES)[0])
        self.error_counts_[place] += 1
        share = max(ERROR_RATE, 1.0 / self.error_counts_[place])
        self.errors_[place] += share * (error**2 - self.errors_[place])
        unknown = self.error_counts_ == 0
        self.errors_[unknown] = self.errors_[~unknown].mean()

    def _stored(self, samples: NDArray[np.float32]) -> NDArray[np.uint8]:
        return np.clip(np.rint(samples), 0, 255).astype(np.uint8)

    def _train(self, n_steps: int) -> None:
        targets = self.targets_[: self.memory_.n_kept]
        wanted = self.outputs_.apply(targets[:, np.newaxis])[:, 0]
        for _ in range(n_steps):
            # A generator per step: a restored model goes on as the original would.
            rng = np.random.default_rng([self.random_state, self.n_steps_])
            chosen = draw_evenly(targets, rng.random(self.batch), BALANCE)
            images = self._tensor(self.samples_[chosen])
            error = self.network_(images)[:, 0] - torch.from_numpy(wanted[chosen])
            self.optimiser_.zero_grad()
            (0.5 * (error**2).mean()).backward()
            self.optimiser_.step()
            self._average()
            self.n_steps_ += 1

    def _average(self) -> None:
        # The mean of few steps must not remember the random start.
        share = max(1.0 - AVERAGE, 1.0 / (self.n_steps_ + 1.0))
        with torch.no_grad():
            for mean, weights in zip(
                self.average_.parameters(), self.network_.parameters(), strict=True
            ):
                mean.lerp_(weights, share)

    def _asked(self, samples: NDArray[np.float32]) -> Floats:
        """In deviations from the mean target, (n,)."""
        with torch.no_grad():
            parts = [
                self.average_(self._tensor(samples[start : start + CHUNK])).numpy()[:, 0]
                for start in range(0, len(samples), CHUNK)
            ]
        return np.concatenate(parts).astype(np.float64)

    def _tensor(self, images: NDArray[np.generic]) -> torch.Tensor:
        """Grey levels (n, height * width) as the network wants them."""
        scaled = (images.astype(np.float32) - np.float32(MID_GREY)) / np.float32(GREY_SPREAD)
        return torch.from_numpy(scaled).reshape(-1, 1, self.height, self.width)


def make_network(height: int, width: int, rng: np.random.Generator) -> nn.Sequential:
    """Images (n, 1, height, width) to (n, 1), with random weights."""
    layers: list[nn.Module] = []
    n_in = 1
    for place, n_out in enumerate(KERNELS):
        layers.append(nn.Conv2d(n_in, n_out, KERNEL_PX, padding=KERNEL_PX // 2))
        pool = nn.MaxPool2d if place == 0 else nn.AvgPool2d
        layers += [pool(3, 2, ceil_mode=True), nn.ReLU()]
        if place < len(KERNELS) - 1:
            # Caffe's weight (5e-5) is for activations of hundreds of grey levels.
            layers.append(nn.LocalResponseNorm(3, alpha=1.0))
        n_in = n_out
        height, width = height // 2, width // 2
    layers += [nn.Flatten(), nn.Linear(n_in * height * width, HIDDEN), nn.ReLU()]
    network = nn.Sequential(*layers, nn.Linear(HIDDEN, 1))
    with torch.no_grad():
        for values in network.parameters():
            n_inputs = values[0].numel()
            start = rng.normal(0.0, np.sqrt(2.0 / n_inputs), values.shape)
            values.copy_(torch.from_numpy(start) if values.ndim > 1 else torch.zeros(values.shape))
    return network
