"""The console: a web page on the racer's machine."""
