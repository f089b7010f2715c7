"""What telemetry confirms: that a verb has done what it says."""

from companion.kernel.messages import FlightMode, LandedState, Telemetry

HEIGHT_TOLERANCE_M = 0.3


def hovers(now: Telemetry, height_m: float) -> bool:
    return (
        now.landed_state is LandedState.IN_AIR
        and now.flight_mode is FlightMode.HOLD
        and abs(-now.position_ned_m[2] - height_m) < HEIGHT_TOLERANCE_M
    )


def is_disarmed(now: Telemetry) -> bool:
    return not now.armed


def left_the_ground(before: Telemetry, now: Telemetry) -> bool:
    on_ground = LandedState.ON_GROUND
    return before.landed_state is on_ground and now.landed_state is not on_ground
