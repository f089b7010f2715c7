"""Links by URL: what may be written, and what it means."""

from enum import StrEnum
from typing import NamedTuple
from urllib.parse import SplitResult, parse_qsl, urlsplit

from companion.kernel.errors import PlanError
from companion.kernel.settings import convert_settings
from sitl.conditions import CLEAR, LinkSettings

LOOPBACK = "127.0.0.1"
DEFAULT_BAUD = 57_600
URL_FORMS = (
    "udpout://HOST:PORT[?local_port=PORT], udpin://[HOST]:PORT, tcpin://[HOST]:PORT or "
    "serial:///dev/DEVICE[:BAUD], each with profile=onboard or profile=gcs behind a ?, UDP with "
    "loss_norm, latency_s, jitter_s, duplicate_norm"
)
SocketAddress = tuple[str, int]


class Profile(StrEnum):
    """Which of PX4's sets of rates a link starts with."""

    ONBOARD = "onboard"
    GCS = "gcs"


class LinkAddress(NamedTuple):
    """``host`` and ``port`` are of the far end for udpout, else of this one."""

    scheme: str
    host: str = LOOPBACK
    port: int = 0
    local_port: int = 0
    device: str = ""
    baud: int = DEFAULT_BAUD
    profile: Profile = Profile.ONBOARD
    conditions: LinkSettings = CLEAR


def parse_link(url: str) -> LinkAddress:
    """Raises PlanError for anything that is not one of the known forms."""
    try:
        parts = urlsplit(url)
        options = dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
        profile = Profile(options.pop("profile", Profile.ONBOARD))
        address = _READERS[parts.scheme](parts, options)._replace(profile=profile)
        if parts.scheme in {"udpin", "udpout"}:
            address = address._replace(conditions=_conditions(options, url))
    except KeyError:
        raise PlanError(f"{url}: not a MAVLink link; use {URL_FORMS}") from None
    except ValueError as error:
        raise PlanError(f"{url}: not a MAVLink link ({error}); use {URL_FORMS}") from None
    if options:
        raise PlanError(f"{url}: unknown option {min(options)!r}; use {URL_FORMS}")
    return address


def _udpout(parts: SplitResult, options: dict[str, str]) -> LinkAddress:
    if not parts.hostname:
        raise ValueError("no host to send to")
    local_port = int(options.pop("local_port", "0"))
    if not 0 <= local_port < 65536:
        raise ValueError("local_port out of range 0-65535")
    return LinkAddress("udpout", parts.hostname, _port(parts), local_port)


def _listening(parts: SplitResult, _: dict[str, str]) -> LinkAddress:
    """Without a host on this machine alone: other machines are let in only when named."""
    return LinkAddress(parts.scheme, parts.hostname or LOOPBACK, _port(parts))


def _conditions(options: dict[str, str], url: str) -> LinkSettings:
    known = [key for key in LinkSettings.__struct_fields__ if key in options]
    given = {key: float(options.pop(key)) for key in known}
    return convert_settings(given, LinkSettings, url) if given else CLEAR


def _serial(parts: SplitResult, _: dict[str, str]) -> LinkAddress:
    device, _colon, baud = parts.path.partition(":")
    if parts.netloc or not device.startswith("/"):
        raise ValueError("no path of a device")
    return LinkAddress("serial", device=device, baud=int(baud) if baud else DEFAULT_BAUD)


def _port(parts: SplitResult) -> int:
    if parts.port is None:
        raise ValueError("no port")
    return parts.port


_READERS = {"udpout": _udpout, "udpin": _listening, "tcpin": _listening, "serial": _serial}
