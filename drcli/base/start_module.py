"""Runs another module as a program: `python -P -m drcli.base.start_module MODULE ARGUMENTS`.

Until that calls `search_as_usual`, imports are faster.
"""

import runpy
import sys

from drcli.base.garbage import search_rarely

if __name__ == "__main__":
    search_rarely()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
