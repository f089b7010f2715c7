"""A multirotor with a stereo camera, made of software; it knows nothing of the learner."""
