"""What a tool says of a log that it cannot use: one line, and an exit code."""

import importlib

import pytest
from mcap.reader import make_reader

READERS = (
    "risk", "table2", "heatmap", "roc", "flightpath", "textons", "picture", "response",
)  # fmt: skip
GATHERERS = ("risk", "table2", "heatmap", "roc")


@pytest.fixture
def use(tmp_path, capsys):
    """Runs a tool on a path; returns (exit code, the only line on stderr)."""

    def run(tool, path):
        words = [str(path)]
        if tool in ("heatmap", "roc"):
            words += ["--out", str(tmp_path / "out")]
        code = importlib.import_module(f"tools.{tool}").main(words)
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert error.startswith(f"{tool}: ")
        return code, error

    return run


@pytest.mark.parametrize("tool", READERS)
@pytest.mark.parametrize("content", [b"", b"not a log"])
def test_what_is_no_log(tool, content, tmp_path, use):
    path = tmp_path / "flight.mcap"
    path.write_bytes(content)
    code, error = use(tool, path)
    assert code == 1
    assert "flight.mcap: not a flight log" in error


@pytest.mark.parametrize("tool", READERS)
def test_a_missing_log(tool, tmp_path, use):
    code, error = use(tool, tmp_path / "none.mcap")
    assert code == 1
    assert "none.mcap: cannot be read" in error


@pytest.mark.parametrize("tool", READERS)
def test_a_log_with_a_damaged_middle(tool, tmp_path, use, invent, moment):
    path = invent([moment()] * 30_00)
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    chunk = chunks[len(chunks) // 2]
    end = chunk.chunk_start_offset + chunk.chunk_length
    content = bytearray(path.read_bytes())
    content[end - 100 : end] = bytes(100)
    path.write_bytes(content)
    code, error = use(tool, path)
    assert code == 1
    assert "damaged" in error


@pytest.mark.parametrize("tool", READERS)
def test_a_flight_that_ended_before_its_first_frame(tool, use, invent):
    code, error = use(tool, invent([]))
    assert code == 1
    assert "nothing was flown" in error


@pytest.mark.parametrize("tool", GATHERERS)
def test_an_empty_folder(tool, tmp_path, use):
    folder = tmp_path / "empty"
    folder.mkdir()
    code, error = use(tool, folder)
    assert code == 2
    assert "flight" in error
    assert "in this folder" in error


def test_a_flight_path_needs_the_truth(use, invent, moment):
    code, error = use("flightpath", invent([moment()] * 3, truth=False))
    assert code == 1
    assert "no truth" in error


def test_a_film_needs_images(use, invent, moment):
    path = invent([moment()] * 3)
    (path.parent / "model.npz").write_bytes(b"")
    assert use("textons", path)[0] == 2  # no model either
    code, error = use("textons", path.with_name("model.npz"))
    assert code == 2
    assert "not a saved model" in error


def test_an_unknown_room_asks_for_its_file(tmp_path, use, invent, moment, monkeypatch):
    monkeypatch.setattr("tools.flown.ROOMS", tmp_path)
    code, error = use("heatmap", invent([moment()] * 3))
    assert code == 2
    assert "no shipped room 'room1'; give --room" in error
