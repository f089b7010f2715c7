"""STATUSTEXTs of an autopilot, as a ground station shows them."""

from pymavlink.dialects.v20 import common as mavlink

from sitl.mavlink.listener import Listener


class TextListener(Listener):
    """Collects texts when asked to: often, or the buffer of the link overflows."""

    def __init__(self, url: str) -> None:
        super().__init__(url, {mavlink.MAVLINK_MSG_ID_STATUSTEXT})
        self._texts: list[str] = []

    def collect(self) -> None:
        self._texts += [message.text for message in self.receive()]

    def drain(self) -> list[str]:
        """The texts since the last call, oldest first."""
        self.collect()
        texts, self._texts = self._texts, []
        return texts
