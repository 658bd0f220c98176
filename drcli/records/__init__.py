"""What machines write: records in the bucket and between processes, and their encoding."""
