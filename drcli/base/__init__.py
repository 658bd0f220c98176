"""What every package may use: errors, problems, files, locks, logs; nothing about DeepRacer."""
