"""Plans and runs to be looked at in 3-D: in the browser, or as a Rerun recording."""
