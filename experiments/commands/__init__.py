"""One file a command: what `eairl NAME` does."""
