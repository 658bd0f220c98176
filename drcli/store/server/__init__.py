"""The embedded S3 server: starts it, finds it again, stops it when it is not used."""
