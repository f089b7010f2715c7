"""The app that flies: stereo teaches one eye to see distance, in flight."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("mono-companion")
except PackageNotFoundError:  # run from a checkout that is not installed
    __version__ = "0"
