"""Command-line tools: ``python -m tools.<verb>``."""
