"""Arms with a hand: one file each, all like `base.Arm`."""
