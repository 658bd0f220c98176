"""Pictures of driven laps: videos, saliency, the episode player."""
