"""Analysis of a training's traces, metrics and files: tables, verdict, advice."""
