"""Tab completion for bash, zsh and fish."""
