"""What is to be relied on: the learned cue, its threshold, the autopilot."""
