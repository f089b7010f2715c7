"""What the vehicle's sensors read, made from the truth."""
