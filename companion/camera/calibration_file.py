"""A camera's geometry as TOML: the fields of StereoCalibration."""

from pathlib import Path

from companion.kernel.calibration import StereoCalibration
from companion.kernel.settings import convert_settings, read_toml


def load_calibration(path: Path) -> StereoCalibration:
    """A StereoCalibration written as TOML. Raises PlanError: file, key and what is allowed."""
    return convert_settings(read_toml(path), StereoCalibration, str(path))
