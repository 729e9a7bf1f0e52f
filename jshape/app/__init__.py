"""Local web pages: the studio (load, draw the goal, plan, edit, carry out, annotate), the viewer.

`editor_state`, `run_controller` and `annotation` know nothing of a browser; the pages show them.
"""
