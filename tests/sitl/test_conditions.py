"""Bad links: what is planted is what happens to the packets, and the vehicle stays in the air."""

import math
import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.errors import PlanError
from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack
from sitl.cli import main
from sitl.conditions import CLEAR, MOST_WAITING, LinkConditions, LinkSettings, Pipe
from sitl.mavlink.impaired import ImpairedSocket
from sitl.mavlink.link_url import parse_link
from sitl.mavlink.links import impair, open_link
from sitl.mavlink.poses import PoseListener

BAD = LinkSettings(loss_norm=0.3, latency_s=0.3, jitter_s=0.2, duplicate_norm=0.2)
PACKETS = 4000


class Clock:
    """A world that is only time."""

    def __init__(self):
        self.time_s = 0.0

    def now_s(self):
        return self.time_s


@pytest.fixture
def clock():
    return Clock()


def conditions(seed=1, **settings):
    return LinkConditions(LinkSettings(**settings), np.random.default_rng(seed))


def carried(clock, seed=1, **settings):
    """(number, seconds on the way) of what arrives of PACKETS sent at 100 Hz."""
    pipe, arrived = Pipe(conditions(seed, **settings), clock.now_s), []
    for step in range(PACKETS + 200):
        clock.time_s = step / 100.0
        if step < PACKETS:
            pipe.put(step)
        arrived += [(number, clock.time_s - number / 100.0) for number in pipe.due()]
    return arrived


def test_a_clear_link_is_none(clock):
    assert carried(clock) == [(number, 0.0) for number in range(PACKETS)]


def test_planted_losses_and_repetitions_are_found(clock):
    numbers = [number for number, _ in carried(clock, loss_norm=0.3, duplicate_norm=0.1)]
    assert len(set(numbers)) / PACKETS == pytest.approx(0.7, abs=0.02)
    assert len(numbers) / len(set(numbers)) == pytest.approx(1.1, abs=0.02)


def test_latency_delays_all_alike_and_jitter_lets_them_overtake(clock):
    late = carried(clock, latency_s=0.3)
    assert [number for number, _ in late] == list(range(PACKETS))
    assert {round(delay_s, 6) for _, delay_s in late} <= {0.3, 0.31}
    numbers, delays_s = zip(*carried(clock, latency_s=0.3, jitter_s=0.2), strict=True)
    assert sorted(numbers) == list(range(PACKETS))
    assert list(numbers) != sorted(numbers)
    assert min(delays_s) >= 0.3 - 1e-9
    assert max(delays_s) <= 0.51
    assert np.mean(delays_s) == pytest.approx(0.405, abs=0.01)


def test_the_same_seed_is_the_same_link(clock):
    one, same, other = (carried(clock, seed, loss_norm=0.3, jitter_s=0.1) for seed in (1, 1, 2))
    assert one == same != other


@given(
    loss=st.floats(0.0, 1.0),
    latency=st.floats(0.0, 2.0),
    jitter=st.floats(0.0, 2.0),
    duplicate=st.floats(0.0, 1.0),
    steps=st.lists(st.floats(0.0, 1.0), max_size=30),
)
def test_nothing_comes_too_early_or_more_than_twice(loss, latency, jitter, duplicate, steps):
    clock = Clock()
    settings = LinkSettings(
        loss_norm=loss, latency_s=latency, jitter_s=jitter, duplicate_norm=duplicate
    )
    pipe = Pipe(LinkConditions(settings, np.random.default_rng(3)), clock.now_s)
    came = []
    for step_s in steps:
        pipe.put(clock.time_s)
        clock.time_s += step_s
        came += [(sent_s, clock.time_s) for sent_s in pipe.due()]
    clock.time_s += 10.0
    came += [(sent_s, clock.time_s) for sent_s in pipe.due()]
    assert all(at_s - sent_s >= latency - 1e-9 for sent_s, at_s in came)
    assert len(came) <= 2 * len(steps)


def test_what_waits_is_bounded(clock):
    pipe = Pipe(conditions(latency_s=1.0), clock.now_s)
    for number in range(2 * MOST_WAITING):
        pipe.put(number)
    clock.time_s = 2.0
    assert len(list(pipe.due())) == MOST_WAITING


def test_a_socket_carries_both_ways_under_its_conditions(clock):
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far,
    ):
        for end in (near, far):
            end.bind(("127.0.0.1", 0))
            end.setblocking(False)
        state = conditions(latency_s=0.5)
        link = ImpairedSocket(near, state, clock.now_s)
        far.sendto(b"up", near.getsockname())
        link.sendto(b"down", far.getsockname())
        with pytest.raises(BlockingIOError):
            link.recvfrom(100)
        with pytest.raises(BlockingIOError):
            far.recv(100)
        clock.time_s = 0.5
        assert link.recvfrom(100) == (b"up", far.getsockname())
        assert far.recv(100) == b"down"
        state.settings = LinkSettings(loss_norm=1.0)  # from now on
        far.sendto(b"up", near.getsockname())
        link.sendto(b"down", far.getsockname())
        clock.time_s = 9.0
        with pytest.raises(BlockingIOError):
            link.recvfrom(100)
        with pytest.raises(BlockingIOError):
            far.recv(100)


def test_conditions_stand_in_the_url():
    url = "udpin://:14550?profile=gcs&loss_norm=0.3&latency_s=0.3&jitter_s=0.2&duplicate_norm=0.2"
    assert parse_link(url).conditions == BAD
    assert parse_link("udpin://:14550").conditions == CLEAR


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("udpin://:0?loss_norm=1.5", "loss_norm: Expected `float` <= 1.0"),
        ("udpin://:0?latency_s=-1", "latency_s: Expected `float` >= 0.0"),
        ("udpin://:0?jitter_s=nan", "jitter_s: nan; must be a finite number"),
        ("udpin://:0?loss_norm=much", "not a MAVLink link (could not convert"),
        ("udpin://:0?loss=0.1", "unknown option 'loss'; use "),
        ("tcpin://:0?loss_norm=0.1", "unknown option 'loss_norm'; use "),
    ],
)
def test_conditions_that_cannot_be_are_refused(url, said, capsys):
    assert main(["run", "nowhere.toml", "--mavlink", url]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_stream_loses_nothing():
    link = open_link("tcpin://127.0.0.1:0")
    with pytest.raises(PlanError, match="only UDP links lose or delay packets"):
        impair([link], [conditions(loss_norm=0.1)], lambda: 0.0)
    link.close()


def test_a_listener_has_no_conditions_of_its_own():
    with pytest.raises(PlanError, match="this end only listens"):
        PoseListener("udpin://127.0.0.1:0?loss_norm=0.1")


@pytest.fixture
def bad_flight(fly_mavlink):
    """A client behind a link of 30 % loss, 300 to 500 ms and repetitions, its streams begun."""
    flight = fly_mavlink()
    state = LinkConditions(BAD, np.random.default_rng(7))
    impair(flight.links, [state, conditions()], lambda: flight.world.time_s)
    return flight


def until_acknowledged(flight, command, *parameters):
    """As a client does: again every half second."""
    for _ in range(20):
        flight.client.command(command, *parameters)
        acks = [m.result for m in flight.run(0.5) if m.get_type() == "COMMAND_ACK"]
        if Ack.ACCEPTED in acks:
            return
    raise AssertionError


def in_the_air(flight):
    flight.run(3.0)
    until_acknowledged(flight, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    until_acknowledged(flight, mavlink.MAV_CMD_NAV_TAKEOFF)
    flight.run(10.0)


def test_a_bad_link_is_flown_over(bad_flight):
    in_the_air(bad_flight)
    counted = [m.get_type() for m in bad_flight.run(20.0)]
    assert 0.65 < counted.count("ODOMETRY") / (20.0 * 30.0 * 1.2) < 0.75
    modes = set()
    for tick in range(200):
        bad_flight.send_setpoint((0.4, 0.0, 0.0))
        if tick == 10:
            until_acknowledged(bad_flight, mavlink.MAV_CMD_DO_SET_MODE, 129.0, 6.0, 0.0)
        bad_flight.run(0.05)
        if tick > 20:
            modes.add(bad_flight.autopilot.status.mode)
    assert modes == {FlightMode.OFFBOARD}
    assert math.hypot(*bad_flight.world.truth.velocity_ned_m_s[:2]) == pytest.approx(0.4, abs=0.1)


def test_a_link_that_is_cut_trips_the_failsafe_and_one_that_comes_back_resumes(fly_mavlink):
    flight = fly_mavlink()
    state = conditions()
    impair(flight.links, [state, conditions()], lambda: flight.world.time_s)
    flight.take_off()
    flight.send_setpoint((0.3, 0.0, 0.0))
    assert flight.acks(mavlink.MAV_CMD_DO_SET_MODE, 129.0, 6.0, 0.0)[-1] is Ack.ACCEPTED

    def stream(duration_s):
        for _ in range(round(duration_s * 20)):
            flight.send_setpoint((0.3, 0.0, 0.0))
            flight.run(0.05)

    stream(1.0)
    state.settings = LinkSettings(loss_norm=1.0)
    stream(0.9)
    assert flight.autopilot.status.mode is FlightMode.OFFBOARD
    stream(0.3)
    assert flight.autopilot.status.failsafe
    state.settings = CLEAR
    stream(0.25)
    assert flight.autopilot.status.mode is FlightMode.OFFBOARD
