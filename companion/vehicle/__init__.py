"""Vehicles: adapters from an autopilot to `Vehicle`."""
