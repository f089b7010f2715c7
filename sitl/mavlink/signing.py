"""MAVLink 2 message signing: https://mavlink.io/en/guide/message_signing.html."""

import hashlib
import hmac
from collections.abc import Callable
from pathlib import Path

from companion.kernel.errors import PlanError
from sitl.mavlink.framing import SIGNATURE_BYTES, Received

KEY_BYTES = 32
_HASH_BYTES = 6
_EPOCH_UNIX_S = 1_420_070_400  # 1 January 2015, where the time stamps of signatures begin
_TICKS_PER_S = 100_000
_NEW_STREAM_TOLERANCE = 60 * _TICKS_PER_S


def read_key(path: Path) -> bytes:
    """32 bytes as they are, or as 64 hexadecimal digits."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PlanError(f"{path}: cannot be read: {error.strerror}") from error
    if len(content) == KEY_BYTES:
        return content
    try:
        key = bytes.fromhex(content.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise PlanError(f"{path}: a signing key is {KEY_BYTES} bytes, or as many in hexadecimal")
    return key


class Keyring:
    """The key that all links share, and the latest time stamp that was seen or given.

    ``unix_s`` tells the date: clients compare it with theirs, against replayed recordings.
    """

    def __init__(self, key: bytes, unix_s: Callable[[], float]) -> None:
        self.key = key
        self._unix_s = unix_s
        self._ticks = 0

    def next_ticks(self) -> int:
        """Tens of microseconds since 2015, each time more than before."""
        self._ticks = max(self._ticks + 1, self._now())
        return self._ticks

    def is_recent(self, ticks: int) -> bool:
        return ticks + _NEW_STREAM_TOLERANCE >= max(self._ticks, self._now())

    def saw(self, ticks: int) -> None:
        self._ticks = max(self._ticks, ticks)

    def _now(self) -> int:
        return round((self._unix_s() - _EPOCH_UNIX_S) * _TICKS_PER_S)


class Signer:
    """Signs what goes to one client, and checks what comes from it."""

    def __init__(self, keyring: Keyring, link_id: int) -> None:
        self._keyring = keyring
        self._link_id = link_id
        self._latest: dict[tuple[int, int, int], int] = {}

    def sign(self, frame: bytes) -> bytes:
        """``frame`` must say in its flags that it is signed."""
        body = frame + bytes((self._link_id,)) + self._keyring.next_ticks().to_bytes(6, "little")
        return body + self._hash(body)

    def accepts(self, received: Received) -> bool:
        """Whether the signature is right, and newer than all before it from the same sender."""
        if not received.signed:
            return False
        frame = received.frame
        body, signature = frame[:-_HASH_BYTES], frame[-_HASH_BYTES:]
        if not hmac.compare_digest(self._hash(body), signature):
            return False
        link_id, ticks = frame[-SIGNATURE_BYTES], int.from_bytes(body[-6:], "little")
        message = received.message
        stream = link_id, message.get_srcSystem(), message.get_srcComponent()
        latest = self._latest.get(stream)
        if ticks <= latest if latest is not None else not self._keyring.is_recent(ticks):
            return False
        self._latest[stream] = ticks
        self._keyring.saw(ticks)
        return True

    def _hash(self, body: bytes) -> bytes:
        return hashlib.sha256(self._keyring.key + body).digest()[:_HASH_BYTES]
