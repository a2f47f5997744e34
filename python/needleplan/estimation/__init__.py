"""Estimation: filters that follow a model through data, curvature from tracked points, calibration of sensors."""
