"""Other systems that models are sent to and fetched from, over the network."""
