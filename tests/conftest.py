"""What all tests share."""

from hypothesis import settings

# The same examples in every run, however slow the machine: a failure is one of the change.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")
