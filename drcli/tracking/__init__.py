"""Sends the figures of a training to the tools of others while it runs."""
