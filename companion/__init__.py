"""The app that flies: stereo teaches one eye to see distance, in flight."""
