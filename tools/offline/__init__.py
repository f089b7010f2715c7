"""The learning lab: learners x settings x training-set sizes x splits, measured on recordings."""
