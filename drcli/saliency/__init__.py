"""Which pixels move a policy's action, how sure it is, and what its critic expects."""
