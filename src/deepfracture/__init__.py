"""deepfracture: brittle fracture, simulated and learned, inside a rigid-body simulation."""

__version__ = "0.1.0"
