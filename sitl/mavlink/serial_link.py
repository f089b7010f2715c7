"""A serial line: one client at its far end, spoken to from the start."""

import os
import termios
from collections.abc import Sequence

from companion.kernel.errors import PlanError, SimulatorError
from sitl.mavlink.link_url import parse_link

READ_BYTES = 4096
_STOP_BITS_AND_PARITY = termios.CSTOPB | termios.PARENB | termios.CRTSCTS


class SerialClient:
    expected = True
    in_stream = True

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""

    def send(self, data: bytes) -> None:
        """A block that the line has begun is finished before the next; those between are lost."""
        self._rest = self._write(self._rest)
        if not self._rest:
            rest = self._write(data)
            self._rest = rest if len(rest) < len(data) else b""

    def admit(self) -> bool:
        return True

    def _write(self, data: bytes) -> bytes:
        """What the line did not take."""
        try:
            return data[os.write(self._descriptor, data) :] if data else b""
        except OSError:  # the line is full, or nobody holds the far end
            return data


class SerialLink:
    """8 data bits, no parity, 1 stop bit, no flow control."""

    def __init__(self, url: str) -> None:
        address = parse_link(url)
        self.url, self.profile = url, address.profile
        speed = getattr(termios, f"B{address.baud}", None)
        if speed is None:
            raise PlanError(f"{url}: {address.baud} is not a baud rate of this system")
        try:
            flags = os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK
            self._descriptor = os.open(address.device, flags)
        except OSError as error:
            raise SimulatorError(f"{url}: cannot be opened: {error.strerror}") from error
        try:
            _make_raw(self._descriptor, speed)
        except termios.error as error:
            os.close(self._descriptor)
            raise SimulatorError(f"{url}: not a serial line: {error.args[1]}") from error
        self._client = SerialClient(self._descriptor)
        self._hung_up = False

    @property
    def clients(self) -> Sequence[SerialClient]:
        return (self._client,)

    def filenos(self) -> list[int]:
        return [] if self._hung_up else [self._descriptor]

    def receive(self) -> tuple[SerialClient, bytes] | None:
        try:
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        self._hung_up = not data  # such a line is always readable: nothing to wait for
        return (self._client, data) if data else None

    def close(self) -> None:
        os.close(self._descriptor)


def _make_raw(descriptor: int, speed: int) -> None:
    iflag, oflag, cflag, lflag, _, _, control = termios.tcgetattr(descriptor)
    iflag = oflag = lflag = 0
    cflag = (cflag & ~_STOP_BITS_AND_PARITY) | termios.CS8 | termios.CREAD | termios.CLOCAL
    settings = [iflag, oflag, cflag, lflag, speed, speed, control]
    termios.tcsetattr(descriptor, termios.TCSANOW, settings)
