"""Recordings of needles by another hand and another formulation than the models: README.md beside this file."""
