"""Races at home: models in the bucket compete on a leaderboard, or in pairs."""
