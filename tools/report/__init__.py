"""A flight or a campaign as one HTML file that needs nothing else."""
