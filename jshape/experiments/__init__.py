"""Whole runs that show something: each makes its data, figures and report."""
