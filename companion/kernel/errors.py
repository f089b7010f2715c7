"""Errors that end a run, each with one line for the user and the exit code it means."""

EXIT_FLOWN = 0
EXIT_FAILED = 1
EXIT_USAGE = 2


class CompanionError(Exception):
    """Base of all errors meant for the user: the text says what, where and what is allowed."""

    exit_code = EXIT_FAILED

    def __str__(self) -> str:
        """One line, whatever of the input is quoted in it."""
        return " ".join(super().__str__().splitlines())


class PlanError(CompanionError):
    """A plan, room, model or option is not what it must be; found before anything moves."""

    exit_code = EXIT_USAGE


class RecordingError(CompanionError):
    """A recording or log cannot be read; names the file."""


class CameraError(CompanionError):
    """The stereo camera cannot be opened, or sends what it did not declare."""


class LinkError(CompanionError):
    """No autopilot on the link, or it went away."""


class VehicleError(CompanionError):
    """The autopilot refused or did not do what it was asked; the text says which and why."""


class SimulatorError(CompanionError):
    """The simulator could not start, or died."""
