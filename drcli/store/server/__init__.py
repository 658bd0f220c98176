"""The embedded S3 server: started, found again, ended when nobody uses it."""
