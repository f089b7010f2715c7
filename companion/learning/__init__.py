"""What one eye learns from stereo, and what its estimate is worth."""
