"""Predicting what an action does to a region of interest."""
