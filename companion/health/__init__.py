"""The cameras' health: what is wrong with each eye and the pair, and what may be used of them."""

from companion.health.monitor import CameraHealth, Look, Outlook
from companion.health.verdicts import HealthSettings

__all__ = ["CameraHealth", "HealthSettings", "Look", "Outlook"]
