"""Where recorded flights lie, for the tests that use them."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def stereoboard():
    """The folder with the stereo-board recordings; tests that need it skip where it is absent."""
    default = REPOSITORY.parent / "shared" / "data" / "stereoboard"
    path = Path(os.environ.get("STEREOBOARD_DIR", default))
    if not path.is_dir():
        pytest.skip("no stereo-board recordings; STEREOBOARD_DIR says where they are")
    return path
