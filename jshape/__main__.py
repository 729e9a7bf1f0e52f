"""`python -m jshape` is the same as `jshape`."""

import sys

from jshape.cli import main

sys.exit(main())
