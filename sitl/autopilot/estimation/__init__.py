"""What the autopilot believes: how sensors let it drift, and what external vision mends."""
