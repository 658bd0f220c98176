"""Stored episodes step by step."""
