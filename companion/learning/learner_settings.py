"""``[learner]``: what is learned and how; presets and the choices they make."""

from typing import Annotated, Literal, NamedTuple

from msgspec import Meta, field

from companion.kernel.settings import Settings
from companion.regressors.slots import Keep
from companion.vision.features import OF_VIEWS, Kind
from companion.vision.stereo import Label
from companion.vision.textons import TextonSettings

TABLE_I = {
    "k": 5,
    "smooth_frames": 4,
    "textons.patch_px": 5,
    "textons.patches": 500,
    "textons.intensity": 10,
    "textons.gradient": 10,
}
"""The paper's Table I, by the path of the setting."""


Target = Literal["linear", "log"]


class Design(NamedTuple):
    """How the estimate is made."""

    features: Kind
    regressor: str
    target: Target
    views: int
    motion: bool


DESIGNS = {
    "paper": Design("textons", "knn", "linear", 0, False),
    "best": Design("gradients", "blend", "log", 5, True),
    "none": Design("textons", "knn", "linear", 0, False),
}
"""What a preset chooses where the plan does not."""
SEES_PIXELS = frozenset({"cnn"})
"""Regressors that want images, not features of them; with the paper's preset that is appendix A."""


class LearnerSettings(Settings, frozen=True):
    """What is learned, from which eye, and when the estimate counts as an obstacle."""

    preset: Literal["paper", "best", "none"] = "paper"
    """"paper" holds k, smooth_frames and the textons to Table I; "best" is what estimates best;
    "none" is the paper's design with all numbers free."""
    features: Kind | None = None
    regressor: str | None = None
    target: Target | None = None
    """The regressor learns λ or its logarithm: near ones must not drown far ones."""
    views: Annotated[int, Meta(ge=0, le=32)] | None = None
    """Mirrored and enlarged views learned from beside each image."""
    motion: bool | None = None
    """In flight and on logs its own motion's parallax counts too (see learning/motion.py)."""
    output: Literal["scalar", "map"] = "scalar"
    """"map" learns λ of each of 6 x 8 cells, and takes the image's λ from them; by a ridge,
    whatever ``regressor`` says."""
    eye: Literal["left", "right"] = "left"
    label: Label = "mean"
    """What stereo's λ is: mean of the disparities, or the value that the top 24 % exceed."""
    threshold: Literal["fixed", "roc", "risk"] = "fixed"
    """"roc" takes the highest threshold that reached ``wanted_tpr`` on the samples so far; "risk"
    one that keeps the two wishes below, the first of them before the second."""
    threshold_px: Annotated[float, Meta(gt=0.0)] | None = None
    """The fixed threshold; none means ``threshold_ratio`` times stereo's."""
    threshold_ratio: Annotated[float, Meta(gt=0.0)] = 1.0
    """Below 1, one eye turns earlier than two (section III-E), and so learns what is near."""
    caution_std: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    """Standard deviations of the estimate added to it: the less certain, the earlier it turns."""
    novelty_limit: Annotated[float, Meta(gt=0.0)] | None = None
    """A frame more novel than this counts as blocked; none lets all pass."""
    wanted_tpr: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.96
    wanted_collision_probability: Annotated[float, Meta(gt=0.0, lt=1.0)] = 1e-3
    """Of one approach to an obstacle."""
    wanted_spurious_turns_per_m: Annotated[float, Meta(gt=0.0)] = 0.1
    detection_distance_m: Annotated[float, Meta(gt=0.0)] = 1.0
    """An obstacle that is detected only nearer than this counts as a collision."""
    k: Annotated[int, Meta(ge=1, le=64)] = 5
    smooth_frames: Annotated[int, Meta(ge=1, le=100)] = 4
    entropy_scale: Annotated[float, Meta(ge=0.0)] = 0.1
    """Weight of the entropy against the histogram's bins. Plain bits (1) would outweigh them all;
    0.1 brings both to the same range. On recorded flights neither generalises better."""
    capacity: Annotated[int, Meta(ge=1, le=10_000_000)] = 100_000
    """Samples kept."""
    keep: Keep = "newest"
    """Beyond the capacity: the newest; or "mixed", half of those and an even sample of all others.
    """
    delay_frames: Annotated[int, Meta(ge=0, le=1000)] = 0
    """Frames that a sample waits before it is learned. Without it, the frame before is the nearest
    neighbour of each, and errors before learning tell little of a wall not just seen."""
    dictionary: str | None = None
    """File with a saved model whose textons are used; none learns them in flight."""
    textons: TextonSettings = field(default_factory=TextonSettings)

    def __post_init__(self) -> None:
        if self.preset == "paper":
            self._check_paper()
        design = self.design
        if design.views and design.features not in OF_VIEWS:
            raise ValueError(f'views must be 0 with features "{design.features}"')
        if self.dictionary is not None and design.features in OF_VIEWS:
            raise ValueError(f'dictionary: features "{design.features}" use no textons')
        if design.regressor in SEES_PIXELS and design.features != "pixels":
            raise ValueError(f'regressor "{design.regressor}" needs features = "pixels"')

    @property
    def design(self) -> Design:
        """The preset's choices, with the plan's own in their place."""
        chosen = {key: getattr(self, key) for key in Design._fields}
        given = {key: value for key, value in chosen.items() if value is not None}
        if self.regressor in SEES_PIXELS:
            given.setdefault("features", "pixels")
        return DESIGNS[self.preset]._replace(**given)

    def _check_paper(self) -> None:
        for path, wanted in TABLE_I.items():
            section, _, key = path.rpartition(".")
            self._refuse(path, getattr(self.textons if section else self, key), wanted)
        papers = DESIGNS["paper"]
        if self.design.regressor in SEES_PIXELS:
            papers = papers._replace(features="pixels")
        for key in ("features", "target", "views", "motion"):
            self._refuse(key, getattr(self.design, key), getattr(papers, key))

    @staticmethod
    def _refuse(path: str, value: object, wanted: object) -> None:
        if value != wanted:
            raise ValueError(
                f'{path} = {value} contradicts preset "paper", where it is {wanted}; '
                'preset "none" allows it'
            )

    def fixed_threshold_px(self, stereo_threshold_px: float) -> float:
        """λ above which one eye turns, unless the ROC says better."""
        if self.threshold_px is not None:
            return self.threshold_px
        return self.threshold_ratio * stereo_threshold_px
