"""The only code that touches the disk: data sets, banks, runs, images and point clouds."""
