"""Small recordings whose truth is planted: walls of tiles that grow as they come nearer."""

import math

import numpy as np
import pytest

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import StereoFrame
from tools.record import AslWriter

EYE = Intrinsics(120.0, 120.0, 64.0, 48.0)
CALIBRATION = StereoCalibration(128, 96, EYE, EYE, baseline_m=0.06)


def write_walls(folder, seed, n_frames):
    """Flights to and from a wall: the nearer, the larger its tiles and λ."""
    rng = np.random.default_rng(seed)
    writer = AslWriter(folder, CALIBRATION)
    for index in range(n_frames):
        disparity_px = round(5.5 - 4.5 * math.cos(index / 6.0))
        tile_px = 2 * disparity_px
        shape = 96 // tile_px + 2, 160 // tile_px + 2
        wall = np.kron(rng.integers(40, 216, shape), np.ones((tile_px, tile_px)))
        wall = np.clip(wall + rng.normal(0, 4, wall.shape), 0, 255).astype(np.uint8)
        left, right = wall[:96, :128], wall[:96, disparity_px : disparity_px + 128]
        writer.write(StereoFrame(index * 10**8, left.copy(), right.copy()))


@pytest.fixture(scope="session")
def takes(tmp_path_factory):
    """A folder with the recordings a, b and c."""
    folder = tmp_path_factory.mktemp("takes")
    for seed, name in enumerate("abc"):
        write_walls(folder / name, seed, n_frames=60)
    return folder


BASE = """
sizes = [20, 60]
positive_threshold_px = 5.0
[set]
learner = { preset = "none", textons.training_images = 10 }
"""


@pytest.fixture
def study_file(tmp_path):
    """``study_file(text)``: a study with these tables behind the usual ones."""

    def write(text="", base=BASE, name="study.toml"):
        path = tmp_path / name
        path.write_text(base + text)
        return path

    return write
