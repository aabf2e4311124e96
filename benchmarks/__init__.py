"""What the package promises of speed, memory and accuracy, measured: `make bench`."""
