"""A flight plan: the TOML file that says everything about a flight."""

import tomllib
from collections.abc import Sequence
from os.path import isfile
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, field

from companion.flying.behaviour import BehaviourSettings
from companion.flying.pilot import PilotSettings
from companion.flying.push_back import PushBackSettings
from companion.flying.safety import SafetySettings
from companion.flying.switch import ExperimentSettings
from companion.health import HealthSettings
from companion.judging.drift import DriftSettings
from companion.judging.trust import TrustSettings
from companion.kernel.errors import PlanError
from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings, convert_settings, read_toml
from companion.learning.learner_settings import LearnerSettings
from companion.vision.stereo import StereoSettings


class CameraSettings(Settings, frozen=True):
    """``[camera]``: how often the stereo pair is exposed, and where it is mounted."""

    rate_hz: Annotated[float, Meta(ge=1, le=120)] = 10.0
    mount_frd_m: Vector3 = (0.1, 0.0, 0.0)
    """Midway between the eyes, from the vehicle's centre: they move when it turns."""


class LogSettings(Settings, frozen=True):
    """``[log]``: what goes into flight.mcap beside the decisions."""

    images: Literal["off", "stereo"] = "off"
    """``stereo`` logs both eyes, about 150 MB for ten minutes at 10 Hz."""
    model_period_s: Annotated[float, Meta(ge=0, le=3600)] = 30.0
    """What was learned is saved this often in flight, and at landing; 0: only at landing."""


class Plan(Settings, frozen=True):
    """The whole plan; every table is optional but ``room`` is needed to fly in a simulator."""

    room: str = ""
    """Room file, relative to the plan; a bare name means ``rooms/NAME.toml``."""
    seed: Annotated[int, Meta(ge=0)] = 1
    camera: CameraSettings = CameraSettings()
    experiment: ExperimentSettings = ExperimentSettings()
    behaviour: BehaviourSettings = BehaviourSettings()
    stereo: StereoSettings = StereoSettings()
    learner: LearnerSettings = LearnerSettings()
    trust: TrustSettings = TrustSettings()
    pilot: PilotSettings = PilotSettings()
    safety: SafetySettings = SafetySettings()
    health: HealthSettings = HealthSettings()
    drift: DriftSettings = DriftSettings()
    push_back: PushBackSettings = PushBackSettings()
    log: LogSettings = LogSettings()
    sitl: dict[str, Any] = field(default_factory=dict)
    """Handed to the simulator, which checks it (see flightplans/README.md)."""


def load_plan(path: Path | None, overrides: Sequence[str] = (), seed: int | None = None) -> Plan:
    """The plan in ``path`` (None: all defaults) with ``KEY=VALUE`` overrides. Raises PlanError."""
    table = read_toml(path) if path else {}
    for override in overrides:
        _apply_override(table, override)
    if seed is not None:
        table["seed"] = seed
    source = str(path) if path else "plan"
    plan = convert_settings(table, Plan, source)
    _check_together(plan, source)
    return plan


def room_path(plan: Plan, plan_path: Path) -> Path:
    """Where the plan's room lies. Raises PlanError when it is missing."""
    if not plan.room:
        raise PlanError(f"{plan_path}: room: missing; a simulated flight needs a room file")
    name = plan.room if plan.room.endswith(".toml") else f"rooms/{plan.room}.toml"
    path = plan_path.parent / name
    if not isfile(path):  # also False for a name that no file system takes
        known = sorted(file.stem for file in (plan_path.parent / "rooms").glob("*.toml"))
        raise PlanError(
            f"{plan_path}: room: {path} does not exist; rooms here: {', '.join(known) or 'none'}"
        )
    return path


def _apply_override(table: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    *parents, last = key.strip().split(".")
    if not equals or not last or not all(parents):
        raise PlanError(f"--set {override}: must be KEY=VALUE, e.g. experiment.scheme=dagger")
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise PlanError(f"--set {override}: {parent} is a value, not a table")
    table[last] = _toml_value(text.strip())


def _toml_value(text: str) -> object:
    """The text as a TOML value; a bare word is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return text


def _check_together(plan: Plan, source: str) -> None:
    """What no single key can show."""
    behaviour = plan.behaviour
    if behaviour.override_threshold_px < behaviour.turn_threshold_px:
        raise PlanError(
            f"{source}: behaviour.override_threshold_px: {behaviour.override_threshold_px} is "
            f"below turn_threshold_px {behaviour.turn_threshold_px}; must not be"
        )
    if behaviour.speed_by_certainty and behaviour.speed_floor_m_s > behaviour.forward_speed_m_s:
        raise PlanError(
            f"{source}: behaviour.speed_floor_m_s: {behaviour.speed_floor_m_s} exceeds "
            f"forward_speed_m_s {behaviour.forward_speed_m_s}"
        )
    if behaviour.forward_speed_m_s > plan.safety.max_speed_m_s:
        raise PlanError(
            f"{source}: behaviour.forward_speed_m_s: {behaviour.forward_speed_m_s} exceeds "
            f"safety.max_speed_m_s {plan.safety.max_speed_m_s}"
        )
    if behaviour.height_m > plan.safety.geofence_height_m:
        raise PlanError(
            f"{source}: behaviour.height_m: {behaviour.height_m} exceeds "
            f"safety.geofence_height_m {plan.safety.geofence_height_m}"
        )
    if behaviour.turn_to == "freer" and plan.learner.output != "map":
        raise PlanError(
            f'{source}: behaviour.turn_to: "freer" needs learner.output = "map": one eye must '
            "know a side from the other"
        )
    safety = plan.safety
    if not safety.stop_after_s < safety.hold_after_s < safety.land_after_s:
        raise PlanError(f"{source}: safety: needs stop_after_s < hold_after_s < land_after_s")
