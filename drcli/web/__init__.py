"""The console: a web page on the racer's machine that shows what the commands show."""
