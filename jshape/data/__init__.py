"""Pairs of prior and posterior frames: where they come from and how they are split."""
