"""Planning: which actions, where, in which order."""
