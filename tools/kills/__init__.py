"""Kills flights at random moments, and looks at what is left of them."""
