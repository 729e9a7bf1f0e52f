"""Searches for the best sequence of actions: siblings with one signature.

    search(bank, image, goal, candidates, limits, *, max_steps) -> Found

A new planner is one file beside `greedy.py` and one row here.
"""

from jshape.planners import greedy

PLANNERS = {"greedy": greedy.search}
