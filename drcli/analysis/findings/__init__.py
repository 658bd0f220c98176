"""What the tables of a training say: a verdict, topics to draw, and advice with evidence."""
