"""Images to numbers: λ, features, nearness, motion. Plain functions; nothing is learned here."""
