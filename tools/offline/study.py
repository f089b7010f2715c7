"""Study files: what a study asks for, and the variants that it compares."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta, field

from companion.kernel.errors import PlanError
from companion.kernel.settings import Settings, convert_settings, read_toml
from companion.learning.learner import Learner
from companion.plan import Plan, load_plan
from tools.offline.splits import SplitSettings
from tools.overrides import as_word, leaves

SETTING = "setting"
"""The dimension of the ``[[setting]]`` tables."""
LAB = "lab."


class LabSettings(Settings, frozen=True):
    """``lab.*``: what can be varied on recordings but not in flight."""

    image_width_px: Annotated[int, Meta(ge=16, le=4096)] | None = None
    """The learner's image is shrunk to it; stereo keeps its own."""
    dictionary: str = "flight"
    """Images that textons come from: the first ones learned from ("flight"), ones spread over all
    of them ("pooled"), or another recording, relative to the study."""


class NamedSet(Settings, frozen=True):
    """``[[learner]]`` or ``[[setting]]``: a name, and keys of a plan or of ``lab``."""

    name: str
    set: dict[str, Any] = field(default_factory=dict)


class StudySettings(Settings, frozen=True):
    """A study file: every learner with every setting, on every split."""

    question: str = ""
    """Stands above the table."""
    plan: str | None = None
    """Flight plan that all variants start from, relative to the study; none: the defaults."""
    seeds: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(min_length=1)] = (1,)
    sizes: tuple[Annotated[int, Meta(ge=1)], ...] = ()
    """Samples learned, after each of which both sets are scored; none: all there are."""
    order: Literal["flight", "spread"] = "flight"
    """Samples are learned as they were flown, or so that any number of them is spread evenly."""
    scored_frames: Annotated[int, Meta(ge=100)] | None = None
    """At most so many of each set are scored, in runs spread evenly; none: all."""
    positive_threshold_px: Annotated[float, Meta(gt=0.0)] = 4.0
    set: dict[str, Any] = field(default_factory=dict)
    """Keys for all variants."""
    split: tuple[SplitSettings, ...] = (SplitSettings(),)
    learner: tuple[NamedSet, ...] = ()
    setting: tuple[NamedSet, ...] = ()
    vary: dict[str, Any] = field(default_factory=dict)
    """Keys, each with a list of values: one is changed at a time."""


class Variant(msgspec.Struct, frozen=True, kw_only=True):
    """One way to learn, as the study describes it."""

    learner: str
    dimension: str
    """What its setting is a choice of; empty where there is none."""
    setting: str
    plan: Plan
    lab: LabSettings


class Study(msgspec.Struct, frozen=True):
    """All that a study file says."""

    path: Path
    settings: StudySettings
    variants: tuple[Variant, ...]

    @property
    def name(self) -> str:
        return self.path.stem


def find_studies(path: Path) -> list[Path]:
    """The file itself, or the studies in a folder. Raises PlanError where it has none."""
    found = sorted(path.glob("*.toml")) if path.is_dir() else [path]
    if not found:
        raise PlanError(f"{path}: no study (*.toml) in this folder")
    return found


def load_study(path: Path) -> Study:
    """The study in ``path``. Raises PlanError: file, key and what is allowed."""
    settings = convert_settings(read_toml(path), StudySettings, str(path))
    labels = [split.label for split in settings.split]
    if len(set(labels)) < len(labels):
        raise PlanError(f"{path}: split: two are called {labels}; give each a name")
    variants = tuple(_variants(settings, path))
    keys = [(variant.learner, variant.dimension, variant.setting) for variant in variants]
    for key in keys:
        if keys.count(key) > 1:
            raise PlanError(f"{path}: two variants are called {' '.join(filter(None, key))!r}")
    return Study(path, settings, variants)


def _variants(settings: StudySettings, path: Path) -> Iterator[Variant]:
    learners = settings.learner or (NamedSet(name=""),)
    choices = [(SETTING, choice.name, choice.set) for choice in settings.setting]
    for key, values in leaves(settings.vary):
        if not isinstance(values, list) or not values:
            raise PlanError(f"{path}: vary: {key}: must be a list of values, e.g. [1, 2]")
        choices += [(key, _text(value), {key: value}) for value in values]
    for learner, (dimension, label, table) in itertools.product(
        learners, choices or [("", "", {})]
    ):
        where = " ".join(filter(None, (str(path), learner.name, dimension, label)))
        tables = settings.set, learner.set, table
        yield _variant(settings, path, where, tables, (learner.name, dimension, label))


def _variant(
    settings: StudySettings,
    path: Path,
    where: str,
    tables: tuple[dict[str, Any], ...],
    names: tuple[str, str, str],
) -> Variant:
    words: list[str] = []
    lab: dict[str, Any] = {}
    for key, value in itertools.chain.from_iterable(map(leaves, tables)):
        if key.startswith(LAB):
            lab[key.removeprefix(LAB)] = value
        else:
            words.append(as_word(key, value))
    try:
        plan = load_plan(path.parent / settings.plan if settings.plan else None, words)
        # Whatever a learner refuses, it refuses before anything is measured.
        Learner(plan.learner, np.random.default_rng(0))
        chosen = convert_settings(lab, LabSettings, "lab")
        sees_map = plan.learner.design.views or plan.learner.output == "map"
        if chosen.image_width_px and sees_map:
            raise PlanError("lab.image_width_px: views and maps need the camera's own image")
    except PlanError as error:
        raise PlanError(f"{where}: {error}") from error
    learner, dimension, setting = names
    return Variant(learner=learner, dimension=dimension, setting=setting, plan=plan, lab=chosen)


def _text(value: object) -> str:
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()
