"""The node that records topics, and the parameters of all nodes, into a bag."""
