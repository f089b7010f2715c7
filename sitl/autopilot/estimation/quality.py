"""What the estimator says of its own estimate."""

from typing import NamedTuple


class Ratios(NamedTuple):
    """The newest innovations of vision over their gates, squared; above 1 they were refused."""

    velocity: float = 0.0
    level: float = 0.0
    down: float = 0.0


class Quality(NamedTuple):
    """Deviations are standard deviations."""

    level_valid: bool
    """Velocity on the level, and so the position, is known."""
    height_valid: bool
    absolute: bool
    """The position is that of external vision, and does not walk away."""
    level_deviation_m: float
    height_deviation_m: float
    velocity_deviation_m_s: float
    tilt_deviation_rad: float
    yaw_deviation_rad: float
    ratios: Ratios
    resets: int
    """How often the position has jumped."""
