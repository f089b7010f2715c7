"""Frames of reference, and the few rotations between them.

======  =======================================  ==================================
frame   axes                                     origin
======  =======================================  ==================================
NED     north, east, down (m)                    home: where the vehicle was armed
FRD     forward, right, down (m), body fixed     the vehicle's centre of mass
HFRD    forward, right, down (m), level          as FRD, but turned by yaw only
CAM     right, down, forward (m)                 the optical centre of one eye
======  =======================================  ==================================

Quaternions are (w, x, y, z) with w >= 0 and named ``ned_from_frd``: they turn a vector written in
FRD into one written in NED. Euler angles are (roll, pitch, yaw) in radians, intrinsic z-y-x.
"""

import math

import numpy as np
from numpy.typing import NDArray

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def wrap_angle_rad(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def quaternion_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """``ned_from_frd`` from (roll, pitch, yaw)."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])


def euler_from_quaternion(ned_from_frd: Quaternion) -> Vector3:
    """(roll, pitch, yaw) in radians."""
    w, x, y, z = ned_from_frd
    roll_rad = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch_rad = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll_rad, pitch_rad, yaw_rad


def matrix_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> NDArray[np.float64]:
    """``ned_from_frd`` as a rotation matrix of shape (3, 3)."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )


def ned_from_hfrd(forward: float, right: float, yaw_rad: float) -> tuple[float, float]:
    """(north, east) of a level vector given as (forward, right) at this yaw."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return c * forward - s * right, s * forward + c * right


def hfrd_from_ned(north: float, east: float, yaw_rad: float) -> tuple[float, float]:
    """(forward, right) at this yaw of a level vector given as (north, east)."""
    return ned_from_hfrd(north, east, -yaw_rad)
