"""How close our car drives to recorded drives of the reference simulator."""
