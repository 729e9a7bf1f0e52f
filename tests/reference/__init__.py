"""Slow plain-NumPy twins, written from the paper's text alone; the fast paths must equal them."""
