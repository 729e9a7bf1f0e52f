"""`python -m jshape` is the same as `jshape`."""

import sys

from jshape.cli.main import main

sys.exit(main())
