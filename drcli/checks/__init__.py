"""Everything that is examined: before a start, the machine, words, and how fast it trains."""
