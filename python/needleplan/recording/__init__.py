"""Recordings: measurements as files."""
