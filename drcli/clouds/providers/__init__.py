"""One module for each cloud; its `CLOUD` is all that others read."""
