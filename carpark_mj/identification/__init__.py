"""Parameters of a car from the log of a test drive, by simulation and least squares."""
