"""Mission tests: a vehicle in a room for a pytest test, and verbs that read like a flight card.

May import the companion and the simulator; nobody imports it but tests.
"""

from flightcard.errors import NotMetError

__all__ = ["NotMetError"]
