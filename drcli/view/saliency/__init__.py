"""Explains a policy's actions by pixels."""
