"""From λ to a safe setpoint: which cue flies, where to, how fast."""
