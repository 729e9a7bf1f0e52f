"""Depth cameras: one file each, all like `base.DepthCamera`."""
