"""A study from the command line: measured, kept, gone on with, written down."""

import csv
import json
from pathlib import Path

import pytest

from companion.kernel.errors import PlanError
from tools.offline.__main__ import main
from tools.offline.store import Stored, find_recordings

LEARNERS = """
[[learner]]
name = "kNN"
[[learner]]
name = "mean"
set.learner.regressor = "mean"
[[split]]
name = "others"
folds = 3
[[split]]
name = "later"
kind = "time"
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("lab")


@pytest.fixture
def words(takes, place, study_file):
    """Of the command line, for a study with these tables."""

    def make(text=LEARNERS, out="out", **changes):
        return [str(study_file(text, **changes)), str(takes), "--out", str(place / out),
                "--cache", str(place / "cache"), "--workers", "1"]  # fmt: skip

    return make


@pytest.fixture
def told(place):
    return lambda name="out": json.loads((place / name / "study.json").read_text())


def test_a_study_beats_the_mean_and_leaves_table_and_figures(words, told, place, capsys):
    assert main(words()) == 0
    assert "kNN" in capsys.readouterr().out
    points = told()["points"]
    tested = {(p["learner"], p["split"], p["size"]): p["test"] for p in points}
    assert len(tested) == 2 * 2 * 2
    knn, mean = tested["kNN", "others", 60], tested["mean", "others", 60]
    assert knn["auc"]["mean"] > 0.9
    assert mean["auc"]["mean"] == pytest.approx(0.5, abs=0.02)
    assert knn["mse_over_variance"]["mean"] < 0.5 < mean["mse_over_variance"]["mean"]
    with (place / "out" / "study.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 4
    assert {row["n_test"] for row in rows} == {"60"}
    for kind in ("png", "svg"):
        assert (place / "out" / f"study.{kind}").stat().st_size > 5000


def test_where_it_comes_from_is_written_down(words, told):
    assert main(words()) == 0
    made = told()["made"]
    assert made["command"].startswith("python -m tools.offline ")
    assert made["recordings"] == {"a": 60, "b": 60, "c": 60}
    assert made["seeds"] == [1]


def test_the_same_command_goes_on_where_it_ended(words, told, place):
    """What is done is not done again, and what comes out is the same."""
    assert main(words(out="first")) == 0
    runs = sorted((place / "cache" / "runs").glob("*/*.json"))
    kept = {run: run.stat().st_mtime_ns for run in runs}
    runs[0].unlink()
    assert main(words(out="second")) == 0
    assert told("second")["points"] == told("first")["points"]
    assert runs[0].is_file()
    assert all(run.stat().st_mtime_ns == kept[run] for run in runs[1:])


def test_two_processes_find_the_same_as_one(words, told, place):
    assert main(words(out="one")) == 0
    two = [*words(out="two"), "--workers", "2", "--cache", str(place / "other")]
    assert main(two) == 0
    assert told("two")["points"] == told("one")["points"]


def test_all_studies_of_a_folder_go_to_stdout_as_json(words, capsys):
    """Those that were run before are not measured again."""
    study, *others = words()
    words(LEARNERS, name="another.toml")
    assert main([str(Path(study).parent), *others, "--json"]) == 0
    printed = capsys.readouterr().out
    first, end = json.JSONDecoder().raw_decode(printed)
    second = json.loads(printed[end:])
    assert (first["study"], second["study"]) == ("another", "study")
    assert first["points"] == second["points"]


DIMENSIONS = """
[vary]
learner.k = [1, 5]
lab.image_width_px = [64, 128]
lab.dictionary = ["flight", "pooled", "DICTIONARY"]
"""


def test_dimensions_and_dictionaries_of_other_recordings(words, told, takes):
    text = DIMENSIONS.replace("DICTIONARY", str(takes / "a"))
    assert main(words(text, out="dimensions")) == 0
    points = told("dimensions")["points"]
    best = {p["setting"]: p["test"]["mse"]["mean"] for p in points if p["size"] == 60}
    assert len(best) == 7
    assert best["128"] == best["flight"] == best["5"]
    assert best["64"] != best["128"]


@pytest.mark.parametrize("how", ["views = 2", "output = 'map'"])
def test_views_and_maps_are_learned_from_too(words, told, how):
    text = f"[[setting]]\nname = 'b'\nset.learner = {{ preset = 'best', {how} }}\n"
    assert main(words(text, out="views", base="sizes = [40]\npositive_threshold_px = 5.0\n")) == 0
    (point,) = told("views")["points"]
    assert point["test"]["auc"]["mean"] > 0.9


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("[[split]]\nkind = 'random'", 2, "near-copies"),
        ("[[split]]\ntrain = ['a']\ntest = ['x']", 2, "no recording 'x'; given are: a, b, c"),
        ("[vary]\nlab.dictionary = ['none']", 1, "none: no such recording"),
    ],
)
def test_mistakes_are_one_line(words, capsys, text, code, said):
    assert main(words(text, out="bad")) == code
    error = capsys.readouterr().err
    assert said in error
    assert error.startswith("offline: ")
    assert error.count("\n") == 1


def test_a_trial_that_fails_is_told_after_the_others(words, capsys, place):
    text = """
[[learner]]
name = "fine"
[[learner]]
name = "blind"
set.stereo.min_valid_norm = 1.0
"""
    assert main(words(text, out="blind")) == 1
    assert "2 of 4 trials failed; blind, recordings 0: stereo knew λ" in capsys.readouterr().err


def test_recordings_of_one_name_are_refused(takes, tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(PlanError, match="two recordings are called 'a'"):
        find_recordings([takes, tmp_path / "a"])


def test_a_recording_that_changed_is_another_one(takes, tmp_path):
    before = Stored(takes / "a", tmp_path).key
    assert Stored(takes / "a", tmp_path).key == before
    data = takes / "b" / "mav0" / "cam0" / "data.csv"
    former = Stored(takes / "b", tmp_path).key
    data.write_text(data.read_text() + "# a remark\n")
    assert Stored(takes / "b", tmp_path).key != former
