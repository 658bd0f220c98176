"""Stored episodes step by step: pictures, choices of the policy, reward parameters, maps."""
