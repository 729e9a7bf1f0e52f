"""Fitting banks to pairs, and measuring how wrong they are."""
