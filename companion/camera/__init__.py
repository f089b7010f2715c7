"""Stereo cameras: adapters from a device, a socket or a recording to `StereoCamera`."""
