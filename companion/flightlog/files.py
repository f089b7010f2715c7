"""The file of a log: one whose writer waits for the disk, one that a thread of its own writes."""

import errno
import threading
from pathlib import Path

ANSWER_LIMIT_S = 20.0
"""Wall time without a byte taken after which the disk counts as dead."""


class PatientFile:
    """A new file, written from the front on; whoever writes waits for the disk."""

    waiting_bytes = 0

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._position = 0

    def tell(self) -> int:
        return self._position

    def write(self, data: bytes) -> int:
        """Takes all of ``data``. Raises OSError, as all that follow."""
        self._position += self._file.write(data)
        return len(data)

    def flush(self) -> None:
        """All is with the operating system then."""
        self._file.flush()

    drain = flush

    def close(self) -> None:
        self._file.close()


class BackgroundFile:
    """A new file, written from the front on. ``write`` never waits for the disk.

    Whoever writes looks at ``waiting_bytes`` first and leaves out what has no room. What the disk
    refused raises OSError at the next call.
    """

    def __init__(self, path: Path) -> None:
        self.waiting_bytes = 0
        self._file = path.open("wb", buffering=0)
        self._position = 0
        self._waiting: list[bytes] = []
        self._error: OSError | None = None
        self._closing = False
        self._changed = threading.Condition()
        # A daemon: a disk that never answers must not keep the process from ending.
        self._thread = threading.Thread(target=self._write_all, name="log", daemon=True)
        self._thread.start()

    def tell(self) -> int:
        return self._position

    def write(self, data: bytes) -> int:
        """Takes all of ``data``. Raises OSError for what went wrong before."""
        with self._changed:
            self._raise_error()
            if not data:  # which would be taken for the end
                return 0
            self._waiting.append(bytes(data))
            self.waiting_bytes += len(data)
            self._position += len(data)
            self._changed.notify_all()
        return len(data)

    def flush(self) -> None:
        """Nothing is held back: what was written is on its way."""

    def drain(self) -> None:
        """Returns when all is with the operating system. Raises OSError."""
        with self._changed:
            self._wait_until_written()
            self._raise_error()

    def close(self) -> None:
        """Raises OSError when not all could be written; the file is closed even then."""
        try:
            self.drain()
        finally:
            with self._changed:
                self._closing = True
                self._changed.notify_all()
            self._thread.join(0.0 if self._is_stuck() else None)

    def _is_stuck(self) -> bool:
        return self._error is not None and self._error.errno == errno.ETIMEDOUT

    def _wait_until_written(self) -> None:
        """Or until nothing more can be expected; the lock is held."""
        while self.waiting_bytes and self._error is None:
            waiting_bytes = self.waiting_bytes
            self._changed.wait(ANSWER_LIMIT_S)
            if self.waiting_bytes == waiting_bytes and self._error is None:
                self._error = OSError(errno.ETIMEDOUT, "the disk does not answer")

    def _raise_error(self) -> None:
        if self._error is not None:
            raise OSError(self._error.errno, self._error.strerror)

    def _write_all(self) -> None:
        """The thread."""
        with self._file:
            while data := self._next():
                try:
                    self._put(data)
                except OSError as error:
                    self._fail(error)
                    return

    def _next(self) -> bytes:
        """All that waits; empty at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closing)
            data = b"".join(self._waiting)
            self._waiting.clear()
            return data

    def _put(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            n_written = self._file.write(rest)
            rest = rest[n_written:]
            with self._changed:
                self.waiting_bytes -= n_written
                self._changed.notify_all()

    def _fail(self, error: OSError) -> None:
        with self._changed:
            self._error = error
            self._waiting.clear()
            self.waiting_bytes = 0
            self._changed.notify_all()
