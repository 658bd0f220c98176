"""What the processes of a run tell each other: typed records and their encoding."""
