"""Chapters 2 to 6 of the thesis and the closed-loop study: published numbers compared with computed ones."""
