"""The plan's ``[sitl]`` table: what the simulated vehicle is made of."""

from typing import Annotated

from msgspec import Meta, field

from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings
from sitl.arena.camera import CameraSettings
from sitl.faults import Event, Faults
from sitl.mavlink.places import Origin

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]


class EstimatorSettings(Settings, frozen=True):
    """How the autopilot's estimate differs from the truth.

    Defaults are of the class of a downward optical-flow camera with a sonar: velocity is wrong by a
    slowly changing amount, and the position, its integral, walks away by about
    ``velocity_bias_m_s * sqrt(2 * velocity_bias_time_s * t)`` after ``t`` seconds: 0.35 m in a
    minute, 0.85 m in six.
    """

    velocity_bias_m_s: NotNegative = 0.01
    """Standard deviation of the slow part of the horizontal velocity's error."""
    velocity_bias_time_s: Positive = 10.0
    velocity_noise_m_s: NotNegative = 0.01
    height_error_m: NotNegative = 0.01
    height_error_time_s: Positive = 2.0
    attitude_error_deg: NotNegative = 0.3
    attitude_error_time_s: Positive = 5.0
    yaw_error_deg: NotNegative = 0.5
    yaw_error_time_s: Positive = 60.0
    gyro_noise_rad_s: NotNegative = 0.002
    accelerometer_noise_m_s2: NotNegative = 0.05
    ready_after_s: NotNegative = 2.0
    drift_ned_m_s: Vector3 = (0.0, 0.0, 0.0)
    """A fault: the velocity is wrong by as much all the time, and the position walks away."""


class BatterySettings(Settings, frozen=True):
    """Three lithium-polymer cells; the AR.Drone's larger pack."""

    capacity_mah: Positive = 1500.0
    charge_norm: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0
    """State of charge at the start."""
    limits_thrust: bool = False
    """Whether the rotors' greatest thrust falls with the square of the voltage."""


class SitlSettings(Settings, frozen=True):
    airframe: str = "ardrone2"
    physics_hz: Annotated[int, Meta(ge=250, le=2000)] = 300
    """A multiple of 50 (control), of 100 (motion capture) and of the camera's rate."""
    wind_ned_m_s: Vector3 = (0.0, 0.0, 0.0)
    home: Origin = Origin()
    gusts_w20_m_s: Annotated[float, Meta(ge=0.0, le=25.0)] = 0.0
    """Turbulence that belongs to this mean wind at 20 ft; see ``sitl.environment.gusts``."""
    ground_effect_norm: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.0
    """Times the textbook's: 0 has none, 1 that of one rotor."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Of the autopilot, by PX4's names, from the start on."""
    faults: Faults = Faults()
    """Present from the start."""
    events: list[Event] = field(default_factory=list)
    """Faults that begin later."""
    estimator: EstimatorSettings = EstimatorSettings()
    battery: BatterySettings = BatterySettings()
    camera: CameraSettings = CameraSettings()
