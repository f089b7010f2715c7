"""Faults, when they come and where: what is expected of each, and what came of it."""
