"""Grids of trainings and simulations over several machines."""
