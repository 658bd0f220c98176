"""Sends a training's figures to other tools."""
