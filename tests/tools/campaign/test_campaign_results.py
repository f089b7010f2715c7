"""The book of results survives being cut off anywhere, and knows what it holds."""

import csv
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.kernel.errors import PlanError, RecordingError
from tools.campaign.plan import load_campaign
from tools.campaign.results import ResultsBook
from tools.campaign.rows import COLUMNS, HEADER, Landed, Row, failed_row, parse_rows, row_line


@pytest.fixture
def flights(campaign_file):
    return load_campaign(campaign_file()).flights


def landed(flight, **figures):
    row = Row(
        id=flight.id, group=flight.group, scheme="dagger", room="office", seed=flight.seed,
        outcome="flown", **figures,
    )  # fmt: skip
    return Landed(row, f"log of {flight.id}".encode())


finite = st.floats(allow_nan=False)
rows = st.builds(
    Row,
    id=st.just("a-0001-0"), group=st.text("ab, \"'=", min_size=1), scheme=st.just("dagger"),
    room=st.just("office"), seed=st.integers(0), outcome=st.just("failed"),
    reason=st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"])),
    overrides=st.none() | st.integers(0), mse=st.none() | finite, sim_s=st.none() | finite,
)  # fmt: skip


@given(rows)
def test_a_row_survives_its_line(tmp_path_factory, row):
    assert parse_rows(HEADER + row_line(row), "results.csv") == [row]


def test_what_is_undefined_stays_undefined(flights):
    (row,) = parse_rows(HEADER + row_line(landed(flights[0], mse=math.nan).row), "results.csv")
    assert math.isnan(row.mse)
    assert row.tpr is None


def test_a_failed_flights_reason_is_one_line(flights):
    row = failed_row(flights[0], "landing:\n  no\tframes\n")
    assert row.reason == "landing: no frames"
    assert row_line(row).count(b"\n") == 1


def test_a_file_cut_off_anywhere_loses_at_most_the_row_it_was_cut_in(flights, tmp_path):
    with ResultsBook(tmp_path / "out") as book:
        for flight in flights:
            book.add(landed(flight, turns=3))
    path = tmp_path / "out" / "results.csv"
    whole = path.read_bytes()

    @given(st.integers(0, len(whole)))
    @settings(max_examples=60)
    def resume_after(cut_bytes):
        path.write_bytes(whole[:cut_bytes])
        kept = max(whole[:cut_bytes].count(b"\n") - 1, 0)
        with ResultsBook(tmp_path / "out") as book:
            missing = book.missing(flights)
            assert missing == list(flights[kept:])
            for flight in missing:
                book.add(landed(flight, turns=3))
        assert path.read_bytes() == whole

    resume_after()


def test_logs_lie_beside_the_rows(flights, tmp_path):
    with ResultsBook(tmp_path) as book:
        book.add(landed(flights[0]))
        assert book.log_path(flights[0].id).read_bytes() == f"log of {flights[0].id}".encode()
    with (tmp_path / "results.csv").open(newline="") as file:
        assert [line["id"] for line in csv.DictReader(file)] == [flights[0].id]


def test_two_campaigns_do_not_share_a_folder(flights, tmp_path):
    with (
        ResultsBook(tmp_path) as book,
        pytest.raises(PlanError, match="another campaign is writing here"),
        ResultsBook(tmp_path),
    ):
        book.add(landed(flights[0]))
    with ResultsBook(tmp_path) as book:
        assert book.missing(flights) == list(flights)


def test_rows_of_other_settings_are_refused(campaign_file, flights, tmp_path):
    with ResultsBook(tmp_path / "out") as book:
        book.add(landed(flights[0]))
    other = load_campaign(campaign_file("runs = 3\n[matrix]\nexperiment.scheme = ['pure_stereo']"))
    with (
        ResultsBook(tmp_path / "out") as book,
        pytest.raises(PlanError, match=r"pure_stereo, seed 1, was flown with other settings"),
    ):
        book.missing(other.flights)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a,b\n1,2\n3", "not the results of a campaign"),
        ("notes", "not the results of a campaign"),
        (",".join(COLUMNS) + "\nx\n", "line 2: "),
    ],
)
def test_files_that_hold_something_else_are_refused(tmp_path, content, said):
    (tmp_path / "results.csv").write_text(content)
    with pytest.raises(RecordingError, match=said), ResultsBook(tmp_path):
        pass
    assert (tmp_path / "results.csv").read_text() == content


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be written: "), ResultsBook(tmp_path / "file"):
        pass
