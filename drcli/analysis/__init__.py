"""What a training shows when its traces, metrics and files are read: tables, verdict, advice."""
