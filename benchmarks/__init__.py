"""Measurements of speed, each beside what else could be used, in one run."""
