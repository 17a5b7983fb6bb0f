"""The tuner on the wire."""
