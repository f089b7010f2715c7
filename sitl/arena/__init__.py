"""Rooms, textures, the raycast stereo camera, contact and motion capture."""
