"""The parameters that act, under PX4's names, in PX4's units (degrees where PX4 has them)."""

import math
from difflib import get_close_matches
from typing import Final, NamedTuple

Number = float | int


class Limits(NamedTuple):
    """A default, and the closed range that may replace it. An int stays an int."""

    default: Number
    lowest: Number
    highest: Number


# Defaults are PX4's except where a reason is given.
PARAMETERS: Final[dict[str, Limits]] = {
    # The pack of this vehicle; PX4 finds the resistance out by itself (-1).
    "BAT1_N_CELLS": Limits(3, 1, 16),
    "BAT1_R_INTERNAL": Limits(0.06, 0.0, 0.2),
    "BAT_CRIT_THR": Limits(0.07, 0.05, 0.5),
    "BAT_EMERGEN_THR": Limits(0.05, 0.03, 0.5),
    "BAT_LOW_THR": Limits(0.15, 0.12, 0.8),
    "COM_ARMABLE": Limits(1, 0, 1),
    "COM_ARM_BAT_MIN": Limits(-1.0, -1.0, 0.9),
    "COM_DISARM_LAND": Limits(2.0, -1.0, 20.0),
    "COM_DISARM_PRFLT": Limits(10.0, -1.0, 100.0),
    # 2, land at the critical level: nobody watches the battery of a vehicle that flies by itself.
    "COM_LOW_BAT_ACT": Limits(2, 0, 3),
    "COM_OBL_RC_ACT": Limits(0, 0, 7),
    "COM_OF_LOSS_T": Limits(1.0, 0.0, 60.0),
    "COM_SPOOLUP_TIME": Limits(1.0, 0.0, 30.0),
    # 0.8 instead of 1 s and 0.15 instead of 0.25 m/s: a small vehicle with a range finder.
    "LNDMC_TRIG_TIME": Limits(0.8, 0.1, 10.0),
    "LNDMC_Z_VEL_MAX": Limits(0.15, 0.1, 1.0),
    "GF_ACTION": Limits(2, 0, 5),
    "GF_MAX_HOR_DIST": Limits(0.0, 0.0, 10_000.0),
    "GF_MAX_VER_DIST": Limits(0.0, 0.0, 10_000.0),
    "MAV_COMP_ID": Limits(1, 1, 250),
    "MAV_HASH_CHK_EN": Limits(1, 0, 1),
    "MAV_PROTO_VER": Limits(0, 0, 2),
    "MAV_SYS_ID": Limits(1, 1, 250),
    "MAV_TYPE": Limits(2, 0, 43),
    "MIS_TAKEOFF_ALT": Limits(2.5, 0.0, 80.0),
    # 1.5 instead of 3 m/s2: the camera nods by 8 degrees, and 0.5 m/s still stops within 0.3 m.
    "MPC_ACC_HOR": Limits(1.5, 1.0, 15.0),
    "MPC_ACC_DOWN_MAX": Limits(3.0, 2.0, 15.0),
    "MPC_ACC_UP_MAX": Limits(4.0, 2.0, 15.0),
    "MPC_JERK_AUTO": Limits(4.0, 1.0, 80.0),
    "MPC_LAND_SPEED": Limits(0.7, 0.6, 3.0),
    "MPC_THR_MAX": Limits(0.9, 0.5, 1.0),  # instead of 1: leaves the mixer room to tilt
    "MPC_THR_MIN": Limits(0.12, 0.05, 0.5),
    "MPC_TKO_RAMP_T": Limits(1.0, 0.0, 5.0),  # instead of 3 s
    "MPC_XY_CRUISE": Limits(1.0, 0.1, 20.0),  # instead of 5 m/s: indoors
    "MPC_XY_VEL_ALL": Limits(-10.0, -20.0, 20.0),
    # 229 instead of 20 degrees/s2: 4 rad/s2, a small vehicle turns at once.
    "MPC_YAWRAUTO_ACC": Limits(math.degrees(4.0), 5.0, 360.0),
    "MPC_Z_VEL_ALL": Limits(-3.0, -3.0, 8.0),
    # 20 instead of 45 degrees, 1 instead of 1.5 m/s and 2 instead of 12 m/s: indoors.
    "MPC_TILTMAX_AIR": Limits(20.0, 5.0, 60.0),
    "MPC_TKO_SPEED": Limits(1.0, 0.5, 5.0),
    "MPC_XY_VEL_MAX": Limits(2.0, 0.0, 20.0),
    "MPC_XY_P": Limits(0.95, 0.0, 2.0),
    # 2.5 and 0.8 instead of 1.8 and 0.4: a small vehicle answers faster.
    "MPC_XY_VEL_P_ACC": Limits(2.5, 1.2, 5.0),
    "MPC_XY_VEL_I_ACC": Limits(0.8, 0.0, 60.0),
    "MPC_YAWRAUTO_MAX": Limits(90.0, 5.0, 360.0),
    "MPC_Z_P": Limits(1.5, 0.1, 1.5),
    "MPC_Z_VEL_I_ACC": Limits(2.0, 0.2, 3.0),
    "MPC_Z_VEL_MAX_DN": Limits(1.5, 0.5, 4.0),
    "MPC_Z_VEL_MAX_UP": Limits(1.5, 0.5, 8.0),
    "MPC_Z_VEL_P_ACC": Limits(4.0, 2.0, 15.0),
    "MC_ORBIT_RAD_MAX": Limits(1000.0, 1.0, 10_000.0),
    "MC_ORBIT_YAW_MOD": Limits(0, 0, 4),
    "MC_PITCHRATE_K": Limits(1.0, 0.01, 5.0),
    "MC_ROLLRATE_K": Limits(1.0, 0.01, 5.0),
    "MC_YAWRATE_K": Limits(1.0, 0.0, 5.0),
    "MC_YAWRATE_MAX": Limits(200.0, 0.0, 1800.0),
    "MC_YAW_P": Limits(2.8, 0.0, 5.0),
    # Missions, return, sticks and failsafes. 0.3 instead of 10 and 0.8 m, 1 instead of 10 m/s,
    # 90 instead of 150 degrees/s, 1.5 and 1 instead of 60 and 30 m: indoors.
    "NAV_ACC_RAD": Limits(0.3, 0.05, 200.0),
    "NAV_MC_ALT_RAD": Limits(0.3, 0.05, 200.0),
    "MIS_DIST_1WP": Limits(10_000.0, -1.0, 100_000.0),
    "MIS_YAW_ERR": Limits(12.0, 0.0, 90.0),
    "MPC_HOLD_DZ": Limits(0.1, 0.0, 0.9),
    "MPC_MAN_Y_MAX": Limits(90.0, 0.0, 400.0),
    "MPC_VEL_MANUAL": Limits(1.0, 0.1, 20.0),
    "RTL_DESCEND_ALT": Limits(1.0, 0.0, 100.0),
    "RTL_LAND_DELAY": Limits(0.0, -1.0, 300.0),
    "RTL_RETURN_ALT": Limits(1.5, 0.0, 150.0),
    # 0 instead of 121212, which switches it off: what tumbles indoors is better off on the floor.
    "CBRK_FLIGHTTERM": Limits(0, 0, 121212),
    "COM_DL_LOSS_T": Limits(10, 5, 300),
    "COM_FAIL_ACT_T": Limits(5.0, 0.0, 25.0),
    "COM_RC_IN_MODE": Limits(3, 0, 8),
    "COM_RC_LOSS_T": Limits(0.5, 0.0, 35.0),
    "COM_RC_OVERRIDE": Limits(1, 0, 3),
    "COM_RC_STICK_OV": Limits(30.0, 5.0, 80.0),
    "COM_RCL_EXCEPT": Limits(0, 0, 31),
    # 0.1 instead of 0.3 s: what tumbles turns over once in 0.4 s, and falls from 2 m in 0.6 s.
    "FD_FAIL_P": Limits(60, 0, 180),
    "FD_FAIL_P_TTRI": Limits(0.1, 0.02, 5.0),
    "FD_FAIL_R": Limits(60, 0, 180),
    "FD_FAIL_R_TTRI": Limits(0.1, 0.02, 5.0),
    "NAV_DLL_ACT": Limits(0, 0, 6),
    "NAV_RCL_ACT": Limits(2, 1, 6),
    # The sonar of this vehicle instead of 0 and 100 m; OVR is read instead of it, unless negative.
    "SIH_DISTSNSR_MAX": Limits(6.0, 0.0, 1000.0),
    "SIH_DISTSNSR_MIN": Limits(0.02, 0.0, 10.0),
    "SIH_DISTSNSR_OVR": Limits(-1.0, -1.0, 1000.0),
    "SIH_WIND_E": Limits(0.0, -20.0, 20.0),
    "SIH_WIND_N": Limits(0.0, -20.0, 20.0),
    "SIM_BARO_OFF_P": Limits(0.0, -100.0, 100.0),
    "SIM_BARO_OFF_T": Limits(0.0, -80.0, 80.0),
    "SIM_BAT_MIN_PCT": Limits(0.0, 0.0, 100.0),  # instead of 50: flights end in an empty battery
    # Sensors and estimate. The range finder instead of the barometer holds the height indoors;
    # 15 instead of 0: who sends motion capture wants it used.
    "EKF2_BARO_CTRL": Limits(1, 0, 1),
    "EKF2_EVA_NOISE": Limits(0.1, 0.05, 10.0),
    "EKF2_EVP_GATE": Limits(5.0, 1.0, 100.0),
    "EKF2_EVP_NOISE": Limits(0.1, 0.01, 10.0),
    "EKF2_EVV_GATE": Limits(3.0, 1.0, 100.0),
    "EKF2_EVV_NOISE": Limits(0.1, 0.01, 10.0),
    "EKF2_EV_CTRL": Limits(15, 0, 15),
    "EKF2_EV_DELAY": Limits(0.0, 0.0, 300.0),
    "EKF2_EV_NOISE_MD": Limits(0, 0, 1),
    "EKF2_EV_QMIN": Limits(0, 0, 100),
    "EKF2_GPS_CTRL": Limits(7, 0, 15),
    "EKF2_GPS_P_GATE": Limits(5.0, 1.0, 100.0),
    "EKF2_GPS_P_NOISE": Limits(0.5, 0.01, 10.0),
    "EKF2_GPS_V_GATE": Limits(5.0, 1.0, 100.0),
    "EKF2_GPS_V_NOISE": Limits(0.3, 0.01, 5.0),
    "EKF2_HGT_REF": Limits(2, 0, 3),
    "EKF2_NOAID_TOUT": Limits(5_000_000, 500_000, 10_000_000),
    "EKF2_OF_CTRL": Limits(1, 0, 1),
    "EKF2_RNG_CTRL": Limits(1, 0, 2),
    "COM_POSCTL_NAVL": Limits(0, 0, 1),
    "MPC_MAN_TILT_MAX": Limits(15.0, 0.0, 90.0),  # instead of 35 degrees: indoors
    # Gusts by MIL-F-8785C and ground effect are this vehicle's; PX4 has neither.
    "SIM_GND_EFFECT": Limits(0.0, 0.0, 2.0),
    "SIM_WIND_GUST": Limits(0.0, 0.0, 25.0),
    "SYS_FAILURE_EN": Limits(0, 0, 1),
    "SIM_GPS_USED": Limits(10, 0, 50),
    "SYS_HAS_GPS": Limits(0, 0, 1),  # instead of 1: there is none indoors
    "SYS_HAS_MAG": Limits(1, 0, 1),
}


_OVERALL: Final[dict[str, dict[str, float]]] = {
    "MPC_XY_VEL_ALL": {"MPC_VEL_MANUAL": 1.0, "MPC_XY_CRUISE": 1.0, "MPC_XY_VEL_MAX": 1.0},
    "MPC_Z_VEL_ALL": {"MPC_Z_VEL_MAX_UP": 1.0, "MPC_Z_VEL_MAX_DN": 0.75},
}
"""Parameters that set others, each to a share of their own value, unless negative; as PX4."""


def default_parameters() -> dict[str, Number]:
    return {name: limits.default for name, limits in PARAMETERS.items()}


def parameter_problem(name: str) -> str:
    """Why ``change_parameter`` refused, in words for a user."""
    limits = PARAMETERS.get(name)
    if limits is not None:
        return f"allowed: {limits.lowest:g} to {limits.highest:g}"
    near = get_close_matches(name, PARAMETERS, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"this vehicle has no such parameter{hint}"


def change_parameter(parameters: dict[str, Number], name: str, value: float) -> bool:
    """False, and no change, for an unknown name or a value outside of the range."""
    limits = PARAMETERS.get(name)
    if limits is None or not math.isfinite(value):
        return False
    number: Number = round(value) if isinstance(limits.default, int) else float(value)
    if not limits.lowest <= number <= limits.highest:
        return False
    parameters[name] = number
    if name in _OVERALL and number >= 0.0:
        for follower, share in _OVERALL[name].items():
            limits = PARAMETERS[follower]
            parameters[follower] = min(limits.highest, max(limits.lowest, share * number))
    return True
