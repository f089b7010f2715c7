"""How a vehicle follows velocities is found again from what it was asked and what it did."""

import re

import numpy as np
import pytest

from companion.flying.push_back import PushBackSettings, Response
from tools import response

PERIOD_NS = 100_000_000


def flown(settings, n_frames=400, noise_m_s=0.02, seed=1):
    """Asked for another velocity every 3 s."""
    rng, model = np.random.default_rng(seed), Response(settings)
    asked_m_s = np.repeat(rng.uniform(-0.5, 0.5, (n_frames // 30 + 1, 2)), 30, axis=0)[:n_frames]
    stamp_ns, flown_m_s = np.arange(n_frames) * PERIOD_NS, []
    for now_ns, asked in zip(stamp_ns.tolist(), asked_m_s.tolist(), strict=True):
        flown_m_s.append(model.velocity_at(now_ns))
        model.ask(now_ns, tuple(asked))
    noisy_m_s = np.array(flown_m_s) + rng.normal(0.0, noise_m_s, (n_frames, 2))
    return response.Following(stamp_ns, asked_m_s, noisy_m_s)


@pytest.mark.parametrize("truth", [(0.1, 6.0, 0.6), (0.3, 3.0, 1.0)])
def test_what_was_planted_is_found_again(truth):
    planted = PushBackSettings(**dict(zip(response.FIELDS, truth, strict=True)))
    found = response.fit([flown(planted), flown(planted, seed=2)])
    assert found.response_delay_s == pytest.approx(truth[0], abs=0.03)
    assert found.response_rad_s == pytest.approx(truth[1], rel=0.1)
    assert found.response_damping == pytest.approx(truth[2], rel=0.1)


def test_time_that_is_missing_in_the_log_costs_nothing():
    whole = flown(PushBackSettings(), noise_m_s=0.0)
    later = whole._replace(stamp_ns=whole.stamp_ns + 5_000_000_000 * (whole.stamp_ns > 15e9))
    assert response.errors_m_s(whole, PushBackSettings()).max() < 1e-9
    assert np.median(response.errors_m_s(later, PushBackSettings())) < 1e-9


def test_the_command_prints_lines_of_a_plan_that_fit_better_than_the_defaults(real_flight, capsys):
    assert response.main([str(real_flight.log_dir)]) == 0
    table, *lines = capsys.readouterr().out.splitlines()
    assert table == "[push_back]"
    assert [line.split(" = ")[0] for line in lines[:3]] == list(response.FIELDS)
    ours, default = (float(re.search(r"([\d.]+) m/s RMS", line)[1]) for line in lines[3:])
    assert ours <= default < 0.1


def test_a_vehicle_that_was_asked_for_nothing_is_refused_in_one_line(invent, moment, capsys):
    assert response.main([str(invent([moment()]))]) == 1
    assert "no records on /setpoint" in capsys.readouterr().err
    still = flown(PushBackSettings())._replace(asked_m_s=np.zeros((400, 2)))
    with pytest.raises(response.PlanError, match="changed less than 5 times"):
        response.fit([still])
