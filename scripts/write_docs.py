"""Runs `python scripts/docs`, under the name that it had in version 0.1.0."""

import sys

from docs.__main__ import main

sys.exit(main())
