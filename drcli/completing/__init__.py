"""Finishes command lines for bash, zsh and fish; loads as little as it can."""
