"""An S3 bucket: on any server, in a folder, and the embedded server."""
