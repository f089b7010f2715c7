"""Poses of another autopilot: late, jittering, lost, repeated; and what is rendered from them."""

import math
import random
import socket
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import quaternion_from_euler
from sitl.arena.track import GAP_LIMIT_NS, PoseTrack
from sitl.build import build_follower
from sitl.mavlink.poses import PoseListener, Report, Source

ROOM = Path(__file__).parents[2] / "flightplans" / "rooms" / "room1.toml"
MS = 1_000_000
TOLERANCE = 1e-6


def motion(stamp_ns):
    """A curve that is straight enough between two reports."""
    t = stamp_ns * 1e-9
    place = (0.3 * t - 1.0, 0.5 * math.sin(0.2 * t), -1.2)
    return place, quaternion_from_euler(0.02 * t, 0.0, 0.4 * t)


def report(stamp_ns, source=Source.ODOMETRY):
    return Report(source, stamp_ns, *motion(stamp_ns))


@given(st.lists(st.integers(0, 3000), min_size=2, unique=True), st.integers(0, 3000), st.randoms())
def test_a_pose_lies_between_its_neighbours_in_whatever_order_they_came(stamps_ms, asked_ms, rng):
    stamps_ns, asked_ns = [ms * MS for ms in stamps_ms], asked_ms * MS
    track = PoseTrack()
    rng.shuffle(stamps_ns)
    for stamp_ns in (*stamps_ns, *stamps_ns[:3]):
        track.add(stamp_ns, *motion(stamp_ns))
    pose = track.at(asked_ns)
    kept = [stamp_ns for stamp_ns in stamps_ns if stamp_ns >= max(stamps_ns) - 2000 * MS]
    before = max((s for s in kept if s <= asked_ns), default=None)
    after = min((s for s in kept if s >= asked_ns), default=None)
    if before is None or after is None or after - before > GAP_LIMIT_NS:
        assert pose is None
        return
    place, attitude = motion(asked_ns)
    assert pose.position_ned_m == pytest.approx(place, abs=2e-3)
    assert abs(sum(a * b for a, b in zip(pose.ned_from_frd, attitude, strict=True))) > 0.99999
    assert math.hypot(*pose.ned_from_frd) == pytest.approx(1.0)


@pytest.fixture(scope="module")
def make_follower():
    def make(seed=1, **settings):
        return build_follower(ROOM, settings, seed, 10.0, 0.06)

    return make


def test_jitter_changes_when_a_frame_comes_but_not_what_it_shows(make_follower):
    stamps_ns = range(0, 2000 * MS, 20 * MS)
    regular, jittery = make_follower(), make_follower()
    expected = []
    for stamp_ns in stamps_ns:
        regular.take(report(stamp_ns))
        expected += regular.look().frames

    rng = random.Random(1)
    arrivals = sorted(stamps_ns, key=lambda stamp_ns: stamp_ns + rng.uniform(0, 60) * MS)
    assert arrivals != list(stamps_ns)
    for number, stamp_ns in enumerate(arrivals):
        jittery.take(report(stamp_ns))
        if number % 7 == 0:  # several at once
            got = jittery.look().frames
            for frame in got:
                same = next(f for f in expected if f.stamp_ns == frame.stamp_ns)
                assert np.abs(frame.left.astype(float) - same.left).mean() < 1.0
    assert [frame.stamp_ns for frame in expected] == [k * 100 * MS for k in range(20)]
    assert jittery.visit(None).frames >= 18


def test_no_frame_is_made_up_in_a_gap_or_outside_of_the_room(make_follower):
    follower = make_follower()
    stamps_ns = [ms * MS for ms in (*range(0, 500, 20), *range(1200, 1500, 20))]
    seen = []
    for stamp_ns in stamps_ns:
        follower.take(report(stamp_ns))
        seen.append(follower.look())
    stamps_ms = [frame.stamp_ns // MS for part in seen for frame in part.frames]
    assert stamps_ms == [0, 100, 200, 300, 400, 1200, 1300, 1400]
    assert follower.visit(None).frames_skipped == 7
    for stamp_ns in range(1500 * MS, 2000 * MS, 50 * MS):
        follower.take(Report(Source.ODOMETRY, stamp_ns, (9.0, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0)))
        assert follower.look().frames == []


def test_a_wall_is_counted_once(make_follower):
    follower = make_follower()
    for k in range(100):
        north_m = 2.4 * math.sin(math.pi * k / 50)  # to the north wall, to the south wall
        pose = (north_m, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0)
        follower.take(Report(Source.ODOMETRY, k * 50 * MS, *pose))
        poses = follower.look().poses
    visit = follower.visit("ODOMETRY")
    assert visit.collisions == 2
    assert visit.minimum_clearance_m == pytest.approx(0.1 - 0.26, abs=0.01)
    assert poses[-1].truth_collisions == 2
    assert poses[-1].truth_position_ned_m[2] == pytest.approx(-1.06)


def test_an_autopilot_that_starts_again_is_followed_again(make_follower):
    follower = make_follower()
    for start_ms in (5000, 0):
        for ms in range(start_ms, start_ms + 300, 20):
            follower.take(report(ms * MS))
            follower.look()
    assert follower.visit(None).frames == 6


class Autopilot:
    """Speaks MAVLink to a listening socket."""

    def __init__(self, url):
        host, port = url.removeprefix("udpin://").split(":")
        self.address = host, int(port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(5.0)
        self.codec = mavlink.MAVLink(None, 1, 1)
        self.say(mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 3, 3))

    def say(self, message):
        self.socket.sendto(message.pack(self.codec), self.address)

    def heard(self):
        return [m for m in self.codec.parse_buffer(self.socket.recv(2048))]

    def say_local(self, ms, north_m):
        self.say(mavlink.MAVLink_local_position_ned_message(ms, north_m, 0.0, -1.0, 0, 0, 0))
        self.say(mavlink.MAVLink_attitude_message(ms, 0.0, 0.0, 0.5, 0, 0, 0))

    def say_odometry(self, ms, north_m):
        nan21 = [math.nan] * 21
        self.say(
            mavlink.MAVLink_odometry_message(
                *(ms * 1000, 1, 1, north_m, 0.0, -1.0, [1, 0, 0, 0]), *(0.0,) * 6, nan21, nan21
            )
        )

    def say_hil(self, ms, north_m):
        lat = round((47.0 + north_m / 111_319.5) * 1e7)
        self.say(
            mavlink.MAVLink_hil_state_quaternion_message(
                *(ms * 1000, [1, 0, 0, 0], 0, 0, 0, lat, 80_000_000, 500_000 + 1000),
                *(0,) * 8,
            )
        )


@pytest.fixture
def link():
    listener = PoseListener("udpin://127.0.0.1:0")
    autopilot = Autopilot(listener.url)
    yield listener, autopilot
    listener.close()
    autopilot.socket.close()


def test_poses_are_asked_for_and_the_best_source_counts(link):
    listener, autopilot = link
    listener.receive()
    asked = {m.param1 for _ in range(5) for m in autopilot.heard() if m.get_type() != "HEARTBEAT"}
    assert asked == {
        mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,
        mavlink.MAVLINK_MSG_ID_ODOMETRY,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
    }
    autopilot.say_local(100, 1.0)
    pieces = listener.receive()
    assert [r.source for r in pieces] == [Source.LOCAL_POSITION_NED] * 2
    assert pieces[0].position_ned_m == (1.0, 0.0, -1.0)
    assert pieces[1].ned_from_frd == pytest.approx(quaternion_from_euler(0.0, 0.0, 0.5), abs=1e-6)

    autopilot.say_odometry(120, 2.0)
    autopilot.say_local(120, 1.0)
    (whole,) = listener.receive()
    assert (whole.source, whole.stamp_ns) == (Source.ODOMETRY, 120 * MS)

    for ms, north_m in ((140, 0.0), (160, 0.5)):
        autopilot.say_hil(ms, north_m)
        autopilot.say_odometry(ms, 2.0)
    reports = listener.receive()
    assert {r.source for r in reports} == {Source.HIL_STATE_QUATERNION}
    assert reports[1].position_ned_m == pytest.approx((0.5, 0.0, 0.0), abs=0.012)


def test_what_is_no_pose_is_ignored(link):
    listener, autopilot = link
    autopilot.say_odometry(100, math.nan)
    autopilot.codec = mavlink.MAVLink(None, 42, 1)
    autopilot.say_odometry(120, 1.0)  # of another system
    autopilot.socket.sendto(b"\xfd\x00garbage" * 30, autopilot.address)
    assert listener.receive() == []
