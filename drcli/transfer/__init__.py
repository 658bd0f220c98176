"""Models on their way: upload, download, export, import, history, removal."""
