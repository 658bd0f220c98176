"""What each DR_ name means, and how the places a value can stand at are put together."""
