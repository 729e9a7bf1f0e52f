"""A local web page: load or look, draw the goal, plan, edit the plan, carry it out, annotate.

`desk` and `notebook` keep what is on the table and know nothing of a browser; `mold_page` and
`annotate_page` show it.
"""
