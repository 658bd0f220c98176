"""Pictures for people: spectator cameras, track maps."""
