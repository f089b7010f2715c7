"""The tests between groups find what was planted, and only that; tables say it in every form."""

import csv
import io
import json
import math

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import ttest_ind

from tools.campaign.rows import Row
from tools.campaign.stats import tabulate, two_sided_p
from tools.campaign.table import print_table, write_table


def row(group, seed, outcome="flown", **figures):
    return Row(
        id=f"{group}-{seed}", group=group, scheme="dagger", room="office", seed=seed,
        outcome=outcome, **figures,
    )  # fmt: skip


def group_of(name, overrides, **figures):
    return [row(name, seed, overrides=int(n), **figures) for seed, n in enumerate(overrides)]


def test_a_planted_difference_is_found():
    """The paper's two best schemes: 10.7 and 4.3 overrides, σ 5.3 and 2.6, 30 runs each."""
    rng = np.random.default_rng(0)
    rows = group_of("dagger", rng.normal(10.7, 5.3, 30).clip(0))
    rows += group_of("wheels", rng.normal(4.3, 2.6, 30).clip(0))
    (test,) = tabulate(rows, ["dagger", "wheels"]).comparisons
    assert (test.first, test.second, test.figure) == ("dagger", "wheels", "overrides")
    assert test.p < 0.001
    assert test.low < test.difference < test.high < 0
    assert test.difference == pytest.approx(-6.4, abs=2.0)


def test_a_planted_equality_is_refused_as_often_as_chance_says():
    rng = np.random.default_rng(1)
    p = [two_sided_p(*rng.normal(10, 3, (2, 30)), rng) for _ in range(100)]
    assert 1 <= sum(value < 0.05 for value in p) <= 11
    assert np.mean(p) == pytest.approx(0.5, abs=0.1)


def test_it_agrees_with_students_test_where_that_holds():
    rng = np.random.default_rng(2)
    first, second = rng.normal(10, 3, 30), rng.normal(11.5, 3, 30)
    student = ttest_ind(first, second).pvalue
    assert two_sided_p(first, second, rng) == pytest.approx(student, abs=0.02)


def test_the_test_is_two_sided_and_survives_groups_without_spread():
    rng = np.random.default_rng(3)
    low, high = np.zeros(10), np.ones(10)
    assert two_sided_p(low, high, rng) == two_sided_p(high, low, rng) < 0.001
    assert two_sided_p(low, low, rng) == 1.0


def test_the_order_of_the_rows_changes_nothing():
    rng = np.random.default_rng(4)
    rows = [r for name in "abc" for r in group_of(name, rng.poisson(5, 8))]
    shuffled = [rows[place] for place in rng.permutation(len(rows))]
    assert tabulate(shuffled, "abc") == tabulate(rows, "abc")
    assert len(tabulate(rows, "abc").comparisons) == 3


def test_failed_flights_count_for_collisions_but_not_for_means():
    rows = [
        row("a", 1, turns=10, collisions=1, distance_flown_m=100.0, test_s=300.0),
        row("a", 2, turns=20, collisions=0, distance_flown_m=140.0, test_s=300.0),
        row("a", 3, "failed", turns=1, collisions=2, distance_flown_m=60.0, test_s=120.0),
        row("a", 4, "failed", reason="no take-off"),
    ]
    (group,) = tabulate(rows, ["a"]).groups
    assert (group.flown, group.failed, group.collisions) == (2, 2, 3)
    assert group.figures["turns"].mean == 15.0
    assert group.figures["turns"].sigma == pytest.approx(math.sqrt(50))
    assert group.collisions_per_min == pytest.approx(3 / 12)
    assert group.distance_per_collision_m == pytest.approx(100.0)


def columns_of(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_figures_that_do_not_exist_are_a_dash_in_every_form(tmp_path):
    figures = {"turns": 40, "collisions": 0, "distance_flown_m": 123.0, "test_s": 300.0}
    rows = [row("stereo", seed, **figures) for seed in (1, 2)]
    rows += group_of("mono", [3, 4], **figures, mse=math.nan, coverage_norm=0.5)
    table = tabulate(rows, ["stereo", "mono", "never flown"])
    write_table(tmp_path, table)
    blocks = (tmp_path / "table.md").read_text().split("\n\n")
    stereo, mono, never = blocks[0].splitlines()[2:]
    assert stereo.startswith("| stereo | 2 | – | 40.00 ± 0.00 |")
    assert stereo.endswith("| 0.00 | > 246 |")
    assert mono.startswith("| mono | 2 | 3.50 ± 0.71 | 40.00 ± 0.00 | 0.50 ± 0.00 | 0.00 |")
    assert blocks[1].splitlines()[3] == "| mono | – | – | – | – |"
    assert never.startswith("| never flown | 0 | – | – |")
    told = json.loads((tmp_path / "table.json").read_text())
    assert told["groups"][0]["figures"]["overrides"] == {"mean": None, "sigma": None, "n": 0}
    lines = columns_of(tmp_path / "table.csv")
    assert (lines[1]["name"], lines[1]["overrides_mean"]) == ("mono", "3.5")
    tested = {(pair["figure"], pair["p"]) for pair in columns_of(tmp_path / "tests.csv")}
    assert tested == {("turns", "1.0"), ("collisions", "1.0")}
    text = io.StringIO()
    print_table(Console(file=text, width=100), table)
    assert "3.50 ± 0.71" in text.getvalue()
    assert "nan" not in text.getvalue()
    assert "…" not in text.getvalue()
