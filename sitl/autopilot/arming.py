"""Whether the motors may turn: arming, spool-up, and disarming by itself."""

from sitl.autopilot.parameters import Number


class Arming:
    """Motors are powered exactly while ``armed``; they give lift once they have spooled up."""

    def __init__(self, parameters: dict[str, Number]) -> None:
        self._parameters = parameters
        self.armed = False
        self.flew = False
        """Whether this arming has left the ground."""
        self._armed_s = 0.0
        self._landed_s = 0.0

    def arm(self, time_s: float) -> None:
        self.armed, self.flew, self._armed_s = True, False, time_s

    def disarm(self) -> None:
        self.armed = False

    def left_ground(self) -> None:
        self.flew = True

    def touched_ground(self, time_s: float) -> None:
        self._landed_s = time_s

    def spooled_up(self, time_s: float) -> bool:
        return self.armed and time_s - self._armed_s >= self._parameters["COM_SPOOLUP_TIME"]

    def reason_to_disarm(self, time_s: float, landed: bool) -> str | None:
        """PX4's words for it, once the vehicle has stood armed for too long."""
        if not (self.armed and landed):
            return None
        if self.flew:
            name, began_s, text = "COM_DISARM_LAND", self._landed_s, "Disarmed by landing"
        else:
            name, began_s = "COM_DISARM_PRFLT", self._armed_s
            text = "Disarmed by auto preflight disarming"
        limit_s = self._parameters[name]
        return text if limit_s > 0.0 and time_s - began_s >= limit_s else None


def arming_problems(
    *,
    allowed: bool,
    estimator_ready: bool,
    battery_ok: bool,
    offboard_without_setpoints: bool,
    upright: bool,
    ground_station_missed: bool,
) -> list[str]:
    """Why arming is refused now; empty when it is not."""
    problems = (
        (not allowed, "not allowed by COM_ARMABLE"),
        (not estimator_ready, "no valid local position estimate"),
        (not battery_ok, "battery too low"),
        (offboard_without_setpoints, "no offboard setpoints"),
        (not upright, "vehicle is not level"),
        (ground_station_missed, "no ground station"),
    )
    return [text for is_so, text in problems if is_so]
