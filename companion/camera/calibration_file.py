"""A camera's geometry as TOML: the fields of StereoCalibration."""

from pathlib import Path

from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import PlanError
from companion.kernel.settings import convert_settings, read_toml


def load_calibration(path: Path) -> StereoCalibration:
    """A StereoCalibration written as TOML. Raises PlanError: file, key and what is allowed."""
    calibration = convert_settings(read_toml(path), StereoCalibration, str(path))
    for name in ("width_px", "height_px", "baseline_m"):
        if getattr(calibration, name) <= 0:
            raise PlanError(f"{path}: {name}: {getattr(calibration, name)}, must be above 0")
    return calibration
