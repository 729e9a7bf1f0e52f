"""Searches for the best sequence of actions: siblings with one signature.

    search(problem: SearchProblem) -> SearchResult

A new planner is one file beside `greedy.py` and one row here.
"""

from jshape.planning.search import careful, greedy, refine

PLANNERS = {
    "greedy": greedy.search,
    "careful": careful.search,
    "refine": refine.search,
}
"""By name."""
