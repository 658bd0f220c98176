"""What shares the track with a car: obstacles, bots, other racers."""
