"""What each command does: from parsed options to a result that JSON can hold.

Each prints for people unless `--json` is given; then only the result is printed, by `cli.main`.
Heavy imports (drawing, OpenCV) happen where they are needed: `jshape --help` must be quick.
"""
