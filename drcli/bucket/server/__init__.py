"""The embedded S3 server: started, found, stopped when idle."""
