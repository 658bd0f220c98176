"""Lists, shows, adds and downloads tracks."""
