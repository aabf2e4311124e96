"""The account of a node: what it did with its messages, published on /progress and on /diagnostics."""
