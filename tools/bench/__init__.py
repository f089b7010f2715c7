"""``python -m tools.bench``: what the app costs, each figure beside a baseline of the same run."""
