"""The two worker loops, each run as a process of its own."""
