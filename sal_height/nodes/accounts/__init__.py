"""What a node did with its messages: the account that it publishes on /progress and on /diagnostics."""
