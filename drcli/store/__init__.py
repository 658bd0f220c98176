"""What lies in the bucket and how it gets there."""
