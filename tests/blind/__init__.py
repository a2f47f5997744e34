"""Recordings and judges of needles by another hand and another formulation than the product: README.md."""
