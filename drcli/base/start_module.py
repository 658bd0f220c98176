"""Runs a module with faster imports: `python -P -m drcli.base.start_module MODULE ARGUMENTS`."""

import runpy
import sys

from drcli.base.processes import search_rarely

if __name__ == "__main__":
    search_rarely()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
