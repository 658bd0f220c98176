"""Moves models and files between buckets: uploads, downloads, what lies where."""
