"""Regressors behind one estimator contract, from a feature vector to λ."""
