"""Study files: what they ask for, and the mistakes that can be made in one."""

from pathlib import Path

import msgspec
import pytest

from companion.kernel.errors import PlanError
from tools.offline.splits import SplitSettings
from tools.offline.study import LabSettings, StudySettings, find_studies, load_study

FOLDER = Path(__file__).parents[3] / "flightplans" / "studies"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_study_loads_and_never_splits_at_random(path):
    if path.stem == "cnn":
        pytest.importorskip("torch", reason='the extra "deep" is not installed')
    study = load_study(path)
    assert {split.kind for split in study.settings.split} <= {"recordings", "time"}
    assert study.settings.question


def test_the_textons_study_is_the_papers_and_one_step_further():
    textons = [v.plan.learner.textons for v in load_study(FOLDER / "textons.toml").variants]
    assert [t.intensity + t.gradient for t in textons] == [4, 8, 12, 16, 20, 40]
    assert all(t.intensity == t.gradient for t in textons)


def test_table1_changes_one_dimension_at_a_time_and_contains_the_papers_value():
    variants = load_study(FOLDER / "table1.toml").variants
    dimensions = {variant.dimension for variant in variants}
    assert len(dimensions) == 9
    paper = load_study(FOLDER / "textons.toml").variants[4].plan.learner
    for dimension in dimensions - {"lab.dictionary", "lab.image_width_px"}:
        assert paper in [v.plan.learner for v in variants if v.dimension == dimension]
    for name in ("lab.dictionary", "lab.image_width_px"):
        assert {v.plan.learner for v in variants if v.dimension == name} == {paper}


def test_learners_settings_and_varied_keys_make_variants(study_file):
    text = """
[[learner]]
name = "near"
[[learner]]
name = "ridge"
set.learner.regressor = "ridge"
[[setting]]
name = "small"
set = { learner.textons = { intensity = 4, gradient = 4 }, lab.image_width_px = 64 }
[vary]
learner.k = [1, 9]
learner.label = ["mean", "quantile"]
"""
    variants = load_study(study_file(text)).variants
    names = [(v.learner, v.dimension, v.setting) for v in variants]
    assert names[:3] == [("near", "setting", "small"), ("near", "learner.k", "1"),
                         ("near", "learner.k", "9")]  # fmt: skip
    assert len(names) == 2 * (1 + 2 + 2)
    assert variants[0].lab == LabSettings(image_width_px=64)
    assert variants[0].plan.learner.textons.gradient == 4
    assert variants[5].plan.learner.design.regressor == "ridge"
    assert variants[0].plan.learner.textons.training_images == 10


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[split]]\nkind = 'random'", r"split\[0\].*near-copies.*allow_random_split = true"),
        ("[[split]]\n[[split]]", "split: two are called"),
        ("[[split]]\nfold = 3", r"split\[0\]\.fold: unknown key; did you mean 'folds'"),
        ("[vary]\nlearner.k = 3", r"vary: learner\.k: must be a list of values"),
        ("[vary]\nlearner.kk = [3]", r"learner\.kk 3: .*kk: unknown key"),
        ("[vary]\nlab.width = [3]", r"lab: width: unknown key; .*image_width_px"),
        ("[vary]\nlearner.k = [3, 3]", "two variants are called 'learner.k 3'"),
        ("[vary]\nlearner.regressor = ['forest']", "no such regressor 'forest'; allowed: blend"),
        (
            "[[setting]]\nname = 'x'\nset = { lab.image_width_px = 64, learner.preset = 'best' }",
            "views and maps need the camera's own image",
        ),
    ],
)
def test_a_wrong_study_is_refused_in_one_line(study_file, text, said):
    with pytest.raises(PlanError, match=said) as caught:
        load_study(study_file(text))
    assert "\n" not in str(caught.value)
    assert "study.toml" in str(caught.value)


def test_every_key_is_documented():
    page = (FOLDER.parent / "README.md").read_text(encoding="utf-8")
    section = page.partition("## Studies")[2].partition("\n## ")[0]
    for kind in (StudySettings, SplitSettings, LabSettings):
        for field in msgspec.structs.fields(kind):
            forms = f"`{field.name}`", f".{field.name}`", f"[{field.name}]"
            assert any(form in section for form in forms), field.name


def test_a_folder_without_studies_is_told(tmp_path):
    with pytest.raises(PlanError, match="no study"):
        find_studies(tmp_path)
    assert len(find_studies(FOLDER)) == 6
