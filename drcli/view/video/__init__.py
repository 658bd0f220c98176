"""Videos of driven laps: traces in, H.264 or GIF out."""
