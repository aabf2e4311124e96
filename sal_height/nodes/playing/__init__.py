"""Nodes that publish a bag: step by step in simulated time, or at a pace, with simulated time or with the system's."""
