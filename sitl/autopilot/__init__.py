"""Modes, arming, control, estimate, failsafes: what a PX4 would do with this airframe."""
